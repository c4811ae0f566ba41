"""Recording -> motion: fuse, filter and differentiate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.recording.clock import resample
from hybrid.recording.recording import Recording
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import (
    butterworth,
    central_difference,
    filter_reach,
    passes_all,
)
from hybrid.signals.speed import SpeedCheck, correction_by_speed


@dataclass(frozen=True)
class Motion:
    """One motion on a uniform clock, at the full rate of its recording.

    ``tau`` is as measured: it is filtered together with the columns of a model, by the
    same :class:`Sampler`, so that both lose the same frequencies.

    Attributes:
        t: Time, uniform, shape (N,), [s].
        q: Joint position, low-pass filtered, shape (N, n), [rad].
        v: Joint speed, shape (N, n), [rad/s].
        a: Joint acceleration, shape (N, n), [rad/s²].
        tau: Measured drive torque, shape (N, n), [N·m].
        temperature: Drive temperature, shape (N, n), [°C], or None.
        mask: True where a sample may be used, shape (N,); the edges, where filters
            and differences are not valid, are False.
        joints: Joint names in column order.
        source: Where it came from.
        number: Which of several recordings it is, counted from 0.
        asked: Torque asked of the drives, shape (N, n), [N·m], where ``tau`` is
            simulated: the same but where the log shows much else; None if not known.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    mask: NDArray[np.bool_]
    temperature: Array | None = None
    joints: tuple[str, ...] = ()
    source: str = ""
    number: int = 0
    asked: Array | None = None

    @property
    def rate(self) -> float:
        """Samples per second, [Hz]."""
        return float((len(self.t) - 1) / (self.t[-1] - self.t[0]))


def motion_from_recording(
    recording: Recording,
    *,
    cutoff: float | None = None,
    speed: SpeedCheck | None = None,
) -> Motion:
    """Filter and differentiate positions; torque stays as measured.

    A measured speed corrects positions where it knows better than they do (see
    :func:`correction_by_speed`); speed and acceleration are the derivatives of these
    positions, exactly consistent with them and with each other.

    Args:
        recording: Joint log; an irregular clock is made uniform first, with a warning.
        cutoff: Cut-off of the position filter, [Hz]; inf for none; chosen from the
            spectrum by :func:`choose_cutoff` if not given.
        speed: What the measured speed of such a log is worth, if that is known.

    Returns:
        The motion at the full rate; its mask leaves out both edges for as long as the
        filter gives what lies outside the log a weight above 1 %.
    """
    recording = resample(recording)
    rate = (len(recording.t) - 1) / recording.duration
    cutoff = choose_cutoff(recording) if cutoff is None else cutoff
    edge = 4
    if not passes_all(rate, cutoff):
        edge += filter_reach(cutoff / rate, tolerance=0.04)
    mask = np.zeros(len(recording.t), dtype=bool)
    mask[edge:-edge] = True
    q = butterworth(recording.q, rate=rate, cutoff=cutoff)
    q = q + correction_by_speed(recording, cutoff=cutoff, mask=mask, check=speed)
    v = central_difference(q, rate=rate)
    a = central_difference(v, rate=rate)
    return Motion(
        t=recording.t,
        q=q,
        v=v,
        a=a,
        tau=recording.tau,
        mask=mask,
        temperature=recording.temperature,
        joints=recording.joints,
        source=recording.source,
    )
