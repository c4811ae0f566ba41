"""Statistics that several verbs share."""

import numpy as np

from hybrid.arrays import Array

HALF_WIDTH = 1.96  # standard deviations on either side of a 95 % interval


def robust_std(x: Array) -> Array:
    """Standard deviation of normal noise that has the median size of x, over axis 0.

    It is zero where there is no value.
    """
    if not len(x):
        return np.zeros(x.shape[1:])
    return np.asarray(1.4826 * np.median(np.abs(x), axis=0))
