"""Statistics that several verbs share."""

import numpy as np
from scipy.special import ndtr, ndtri

from hybrid.arrays import Array

HALF_WIDTH = 1.96  # standard deviations on either side of a 95 % interval


def robust_std(x: Array) -> Array:
    """Standard deviation of normal noise that has the median size of x, over axis 0.

    It is zero where there is no value.
    """
    if not len(x):
        return np.zeros(x.shape[1:])
    return np.asarray(1.4826 * np.median(np.abs(x), axis=0))


def interval_above(least: float, mean: float, std: float) -> tuple[float, float]:
    """Shortest 95 % interval of a normal value that cannot be less than some bound."""
    room = (mean - least) / std
    outside = 2.0 * ndtr(-HALF_WIDTH) * ndtr(room)  # of all that is above the bound
    half = -ndtri((ndtr(-room) + outside) / 2)
    if half <= room:
        return float(mean - half * std), float(mean + half * std)
    return float(least), float(mean - ndtri(outside) * std)
