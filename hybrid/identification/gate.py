"""The test that every new term must pass: it lowers the held-out error of a joint.

The squared residuals of the predicted torque are compared block by block, with and
without the term, so that noise common to both cancels. The term is accepted if the mean
gain over the blocks exceeds its own uncertainty.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hybrid.arrays import Array

_CHANCE = 0.025  # probability that noise alone passes


def lowers(before: Array, after: Array, *, tried: int = 1) -> NDArray[np.bool_]:
    """Whether the held-out squares of each joint fall significantly, shape (n,).

    Args:
        before: Squares of each block without the term, shape (B, n), [N²·m²].
        after: Squares of each block with the term, shape (B, n), [N²·m²].
        tried: Number of terms of which this one is the best.
    """
    gain = before - after
    error = np.sqrt(((gain - gain.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(gain.sum(axis=0) > -ndtri(_CHANCE / tried) * error)
