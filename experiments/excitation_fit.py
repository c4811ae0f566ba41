"""Identification from a periodic log as the SCARA paper does it, and its error.

Near standstill dry friction takes any value below its limit, and the sign of a measured
speed is that of its noise; such samples can be left out of the fit and of the error.
"""

from dataclasses import dataclass, replace

import numpy as np
from periodic import average_periods, fourier_fit

from hybrid.excitation.path import Path
from hybrid.signals import (
    butterworth,
    motion_from_recording,
)

HARMONICS = 20  # of the fit to the averaged speed: the polynomial has many
PERIOD = 10.0  # s


@dataclass(frozen=True)
class Reading:
    """How a log is read.

    Attributes:
        slow: Samples below this speed are left out, [rad/s].
        cutoff: Of the low-pass of the torque error on another motion, [Hz].
        first: First period of the log that is averaged.
    """

    slow: float = 0.05
    cutoff: float = 10.0
    first: int = 0


READINGS = {
    "samples above 0.05 rad/s, error below 10 Hz (tables above)": Reading(),
    "the same, error as logged": Reading(cutoff=np.inf),
    "the same as the first, first period left out": Reading(first=1),
    "all samples, error below 10 Hz": Reading(slow=0.0),
    "all samples, error as logged": Reading(slow=0.0, cutoff=np.inf),
}


def fit(observation, log, reading):
    """Weighted least squares on the average of the periods."""
    mean, noise = average_periods(later(log, reading.first * PERIOD), 1 / PERIOD)
    speed = fourier_fit(mean.t, mean.v, fundamental=1 / PERIOD, order=HARMONICS)
    v, a = speed.position(mean.t), speed.velocity(mean.t)  # the series is of the speed
    path = Path(mean.t, mean.q, v, a, a)
    W = observation.matrix(path, turning_speed=0) / noise[:, None]
    used = np.abs(v) >= reading.slow
    return np.linalg.lstsq(W[used], (mean.tau / noise)[used], rcond=None)[0]


def error(observation, gains, logs, reading):
    """RMS torque error on other motions, shape (n,), [N·m]."""
    squares, count = 0.0, 0
    for log in logs:
        motion = motion_from_recording(log)
        path = Path(motion.t, motion.q, motion.v, motion.a, motion.a)
        left = motion.tau - observation.matrix(path, turning_speed=0) @ gains
        if np.isfinite(reading.cutoff):
            rate = (len(log.t) - 1) / log.duration
            left = butterworth(left, rate=rate, cutoff=reading.cutoff)
        used = motion.mask[:, None] & (np.abs(motion.v) >= reading.slow)
        squares = squares + (np.where(used, left, 0.0) ** 2).sum(axis=0)
        count = count + used.sum(axis=0)
    return np.sqrt(squares / count)


def later(log, start):
    """The log from a time on, [s]."""
    kept = log.t >= log.t[0] + start - 1e-9
    names = ("t", "q", "v", "tau")
    cut = {name: getattr(log, name)[kept] for name in names}
    return replace(log, command=None, temperature=None, **cut)
