"""Which orders of ripple a residual holds: its spectrum over position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array

_MOST_PERIODS = 400
_FILTER_ORDER = 5


def ripple_orders(
    left: Array, q: Array, v: Array, cutoff: float, count: int
) -> NDArray[np.intp]:
    """Strongest whole orders of torque that repeats with position, strongest first.

    A wave of order k passes at k·v/2π: what the filter takes of it at each sample is
    taken into account, so that fast stretches do not hide what slow ones show.

    Args:
        left: Residual of one joint, shape (M,), [N·m].
        q: Its position, shape (M,), [rad].
        v: Its speed, shape (M,), [rad/s].
        cutoff: Cut-off of the filter that the residual went through, [Hz].
        count: How many orders.

    Returns:
        Orders per turn, shape (count,) or fewer.
    """
    step, wave = np.exp(1j * q), np.ones(len(q), dtype=complex)
    pace = (np.abs(v) / (2 * np.pi * cutoff)) ** (2 * _FILTER_ORDER)
    score = np.zeros(_MOST_PERIODS + 1)
    for k in range(1, _MOST_PERIODS + 1):
        wave *= step
        passed = 1.0 / (1.0 + float(k) ** (2 * _FILTER_ORDER) * pace)
        power = passed @ passed
        if power > 0.02 * len(q):
            score[k] = np.abs((passed * left) @ wave) ** 2 / power
    inner = score[1:-1]
    peak = np.flatnonzero((inner >= score[:-2]) & (inner >= score[2:])) + 1
    best = peak[np.argsort(-score[peak])]
    return np.asarray(best[:count])
