"""Size and correlation of torque errors, tracked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array

_MEMORY = 5.0  # s
_FIRST = 20  # updates over which the first guess counts
_CUT = 9.0  # of the variance: most that one square, or one product, counts
_MOST_CORRELATED = 0.98


class TorqueNoise:
    """Size and correlation in time of the errors of each joint, with fading memory.

    Args:
        std: First guess of the standard deviation, shape (n,), [N·m].
        rate: Updates per second, [Hz].
    """

    def __init__(self, std: Array, rate: float) -> None:
        self._variance = [float(x) ** 2 for x in std]
        self._least = [1e-12 * x for x in self._variance]
        self._last = [0.0] * len(self._variance)
        self._count = [0] * len(self._variance)
        self._lagged = 0.0
        self._slowest = 1.0 / (_MEMORY * rate)

    @property
    def std(self) -> Array:
        """Standard deviation of each joint's error, shape (n,), [N·m]."""
        return np.asarray(np.sqrt(self._variance))

    @property
    def repeats(self) -> float:
        """Successive errors that tell as much as one independent one.

        (1 + ρ)/(1 − ρ) where errors follow each other with correlation ρ.
        """
        rho = min(max(self._lagged, 0.0), _MOST_CORRELATED)
        return (1.0 + rho) / (1.0 - rho)

    def update(self, joints: Sequence[int], error: Sequence[float]) -> None:
        """Take in errors of the joints that are used, at unit leverage, [N·m]."""
        # Plain numbers: for a handful of joints they are faster than arrays.
        last, self._last = self._last, [0.0] * len(self._last)
        products, least = [], 1.0
        for j, e in zip(joints, error, strict=True):
            self._count[j] += 1
            share = max(self._slowest, 1.0 / (_FIRST + self._count[j]))
            least, variance = min(least, share), self._variance[j]
            if last[j]:
                products.append(min(max(e * last[j] / variance, -_CUT), _CUT))
            # Cut, so that a change or a blow does not pass for noise.
            news = share * (min(e * e, _CUT * variance) - variance)
            self._variance[j] = max(variance + news, self._least[j])
            self._last[j] = e
        mean = sum(products) / len(products) if products else 0.0
        self._lagged += least * (mean - self._lagged)
