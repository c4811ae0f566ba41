"""The result of an inspection: clock, excitation and doubts of a log."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.files import write_json
from hybrid.inspect.coverage import Excitation, JointCoverage
from hybrid.inspect.doubt import Doubt, is_error
from hybrid.recording import Recording
from hybrid.recording.clock import GAP
from hybrid.shown import Shown


@dataclass(frozen=True)
class Clock:
    """How regular a log's clock is.

    Attributes:
        samples: Number of samples N.
        duration: From first to last, [s].
        rate: From the median step, [Hz].
        jitter: Standard deviation of steps without holes, over the median step.
        missing: Share of samples that a regular clock would have in addition.
        holes: Steps of more than ten times the median.
    """

    samples: int
    duration: float
    rate: float
    jitter: float
    missing: float
    holes: int


@dataclass(frozen=True)
class Inspection(Shown):
    """One log: its clock, what it can tell, and what speaks against it.

    Attributes:
        recording: The log, its joints in the robot's order.
        clock: How regular its clock is.
        joints: What each joint does; empty where samples are wrong.
        excitation: How well it determines an arm; None without robot or torque.
        doubts: What speaks against its columns being what they say; the likeliest
            cause of others first.
    """

    recording: Recording
    clock: Clock
    joints: tuple[JointCoverage, ...]
    excitation: Excitation | None
    doubts: tuple[Doubt, ...]

    @property
    def misleads(self) -> bool:
        """Whether a model of this log would be wrong."""
        return any(map(is_error, self.doubts))

    def save(self, path: str | Path) -> None:
        """Write all that is known of the log to a JSON file."""
        write_json(path, self.as_dict())

    def as_dict(self) -> dict[str, Any]:
        """The same as names, numbers and lists."""
        return {
            "source": self.recording.source,
            "reading": self.recording.reading and self.recording.reading.as_dict(),
            "joints": [asdict(x) for x in self.joints],
            "clock": asdict(self.clock),
            "channels": list(self.recording.channels),
            "excitation": self.excitation and asdict(self.excitation),
            "doubts": [asdict(x) for x in self.doubts],
            "misleads": self.misleads,
        }


def clock_of(recording: Recording) -> Clock:
    """How regular a log's clock is."""
    steps = np.diff(recording.t)
    step = float(np.median(steps))
    filled = steps <= GAP * step
    missing = np.sum(np.round(steps[filled] / step) - 1)
    return Clock(
        samples=len(recording.t),
        duration=recording.duration,
        rate=recording.rate,
        jitter=float(np.std(steps[filled]) / step),
        missing=float(max(missing, 0.0) / len(recording.t)),
        holes=int(np.sum(~filled)),
    )
