"""The gate of the ladder: a rung must lower the error on unseen samples.

For each joint, the held-out squares of the torque that leaves ``predict`` are compared
block by block, with and without the rung, so that noise common to both cancels. A rung
is taken where the mean gain of the blocks exceeds its own uncertainty.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hybrid.arrays import Array

_CHANCE = 0.025  # that noise alone passes, however many terms were tried


def lowers(before: Array, after: Array, *, tried: int = 1) -> NDArray[np.bool_]:
    """Whether the held-out squares of each joint fall significantly.

    Args:
        before: Squares of each block without the rung, shape (B, n), [N²·m²].
        after: The same with it.
        tried: How many rungs it is the best of.

    Returns:
        True for each joint that gains, shape (n,).
    """
    gain = before - after
    error = np.sqrt(((gain - gain.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(gain.sum(axis=0) > -ndtri(_CHANCE / tried) * error)
