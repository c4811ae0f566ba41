"""Identification from a periodic log as the SCARA paper does it, and its error."""

import numpy as np

from hybrid.excitation.path import Path
from hybrid.signals import average_periods, fourier_fit, motion_from_recording

HARMONICS = 20  # of the fit to the averaged speed: the polynomial has many


def fit(observation, log):
    """Weighted least squares on the average of the periods."""
    mean, noise = average_periods(log, 0.1)
    speed = fourier_fit(mean.t, mean.v, fundamental=0.1, order=HARMONICS)
    v, a = speed.position(mean.t), speed.velocity(mean.t)  # the series is of the speed
    path = Path(mean.t, mean.q, v, a, a)
    W = observation.matrix(path, turning_speed=0) / noise[:, None]
    rows = W.reshape(-1, observation.size)
    return np.linalg.lstsq(rows, (mean.tau / noise).ravel(), rcond=None)[0]


def error(observation, gains, log):
    """RMS torque error on another motion, shape (n,), [N·m]."""
    motion = motion_from_recording(log)
    path = Path(motion.t, motion.q, motion.v, motion.a, motion.a)
    left = motion.tau - observation.matrix(path, turning_speed=0) @ gains
    return np.sqrt((left[motion.mask] ** 2).mean(axis=0))
