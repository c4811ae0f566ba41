"""The result of an inspection: clock, joints, excitation and doubts of a log."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.files import write_json
from hybrid.inspect.coverage import Excitation, JointCoverage
from hybrid.inspect.doubt import Doubt
from hybrid.recording import Recording
from hybrid.recording.clock import GAP
from hybrid.shown import Shown, plain


@dataclass(frozen=True)
class Clock:
    """How regular a log's clock is.

    Attributes:
        samples: Number of samples.
        duration: Time from the first sample to the last, [s].
        rate: Inverse of the median step, [Hz].
        jitter: Standard deviation of steps without holes, over the median step.
        missing: Number of samples missing from a regular clock, over ``samples``.
        holes: Number of steps longer than ten median steps.
    """

    samples: int
    duration: float
    rate: float
    jitter: float
    missing: float
    holes: int


@dataclass(frozen=True, repr=False)
class Inspection(Shown):
    """What is known of a log before it is used.

    Attributes:
        recording: The log, its joints in the robot's order.
        clock: How regular its clock is.
        joints: Motion and torque of each joint; empty if samples are wrong.
        excitation: Which parameters it determines; None without robot or torque.
        doubts: Reasons to mistrust it, most reliable first.
    """

    recording: Recording
    clock: Clock
    joints: tuple[JointCoverage, ...]
    excitation: Excitation | None
    doubts: tuple[Doubt, ...]

    @property
    def misleads(self) -> bool:
        """Whether a model of this log would be wrong."""
        return any(doubt.is_error for doubt in self.doubts)

    def save(self, path: str | Path) -> None:
        """Write the inspection to a JSON file."""
        write_json(path, plain(self.as_dict()))

    def as_dict(self) -> dict[str, Any]:
        """The inspection as names, numbers and lists."""
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
    """How regular the clock of a log is."""
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
