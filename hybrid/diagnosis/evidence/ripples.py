"""Orders of torque ripple in a residual, from its spectrum over position."""

import numpy as np

from hybrid.arrays import Array, Index

_MOST_PERIODS = 400  # per turn
_FILTER_ORDER = 5  # of the low-pass filter that signals pass


def ripple_orders(left: Array, q: Array, v: Array, cutoff: float, count: int) -> Index:
    """Strongest orders of torque that is periodic in position, strongest first.

    A ripple of order k has the frequency k·v/2π. Each sample is weighted by what the
    low-pass filter passes at its frequency.

    Args:
        left: Residual of one joint, shape (M,), [N·m].
        q: Its position, shape (M,), [rad].
        v: Its speed, shape (M,), [rad/s].
        cutoff: Cut-off of the residual's filter, [Hz].
        count: Number of orders.

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
        if power <= 0.02 * len(q):
            break  # less is passed of higher orders
        score[k] = np.abs((passed * left) @ wave) ** 2 / power
    inner = score[1:-1]
    peak = np.flatnonzero((inner >= score[:-2]) & (inner >= score[2:])) + 1
    best = peak[np.argsort(-score[peak])]
    return np.asarray(best[:count])
