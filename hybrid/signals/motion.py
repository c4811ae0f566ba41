"""Turn a recording into a motion: filter and differentiate positions."""

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.recording.clock import resample
from hybrid.recording.recording import Recording
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import (
    butterworth,
    central_difference,
    filter_reach,
    passes_all,
)
from hybrid.signals.speed import correction_by_speed


@dataclass(frozen=True)
class Motion:
    """One motion on a uniform clock, at the full rate of its recording.

    ``tau`` is not filtered here. The same :class:`Sampler` later filters it and the
    regressor columns, so that both lose the same frequencies.

    Attributes:
        t: Time, uniform, shape (N,), [s].
        q: Joint position, low-pass filtered, shape (N, n), [rad].
        v: Joint speed, shape (N, n), [rad/s].
        a: Joint acceleration, shape (N, n), [rad/s²].
        tau: Measured drive torque, shape (N, n), [N·m].
        temperature: Drive temperature, shape (N, n), [°C], or None.
        mask: True where a sample may be used, shape (N,); False at the edges, where
            filters and differences are not valid.
        joints: Joint names in column order.
        source: File or folder of the recording.
        number: Index of the recording among several, from 0.
        asked: Torque that the controller commands to the drives, shape (N, n), [N·m];
            None if not known.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    mask: Mask
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
    recording: Recording, *, cutoff: float | None = None
) -> Motion:
    """Filter and differentiate positions; torque stays as measured.

    A measured speed corrects positions at the frequencies where it has less noise (see
    :func:`correction_by_speed`). Speed and acceleration are the derivatives of the
    corrected positions.

    Args:
        recording: Joint log; an irregular clock is made uniform first, with a warning.
        cutoff: Cut-off of the position filter, [Hz]; inf for none; by default
            :func:`choose_cutoff` chooses it.

    Returns:
        The motion at the full rate. Its mask excludes samples at both edges, where
        values beyond the ends of the log have a weight above 1 % in the filter.
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
    q = q + correction_by_speed(recording, cutoff=cutoff, mask=mask)
    v = central_difference(q, rate=rate)
    a = central_difference(v, rate=rate)
    x = recording
    return Motion(x.t, q, v, a, x.tau, mask, x.temperature, x.joints, x.source)
