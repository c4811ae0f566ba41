"""Tracking of the variance and the correlation in time of torque errors."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array

_MEMORY = 5.0  # s
_INITIAL_UPDATES = 20  # that the initial variance is worth
_MOST_SQUARED = 9.0  # of the variance: where one square, or one product, is clipped
_MOST_CORRELATION = 0.98


class TorqueNoise:
    """Variance of each joint's error and its correlation in time, with fading memory.

    It starts at ``std``, shape (n,), [N·m], and has ``rate`` updates per second, [Hz].
    """

    def __init__(self, std: Array, rate: float) -> None:
        self._variance = [float(x) ** 2 for x in std]
        self._least = [1e-12 * x for x in self._variance]
        self._last = [0.0] * len(self._variance)
        self._count = [0] * len(self._variance)
        self._correlation = 0.0
        self._least_share = 1.0 / (_MEMORY * rate)

    @property
    def std(self) -> Array:
        """Standard deviation of each joint's error, shape (n,), [N·m]."""
        return np.asarray(np.sqrt(self._variance))

    @property
    def inflation(self) -> float:
        """Number of successive errors that count as one independent error.

        It is (1 + ρ)/(1 − ρ) for a correlation ρ of successive errors.
        """
        rho = min(max(self._correlation, 0.0), _MOST_CORRELATION)
        return (1.0 + rho) / (1.0 - rho)

    def update(self, joints: Sequence[int], error: Sequence[float]) -> None:
        """Add errors of the moving joints, at unit leverage, [N·m]."""
        # Plain numbers are faster than arrays for a few joints.
        last, self._last = self._last, [0.0] * len(self._last)
        products, least = [], 1.0
        for j, e in zip(joints, error, strict=True):
            self._count[j] += 1
            share = max(self._least_share, 1.0 / (_INITIAL_UPDATES + self._count[j]))
            least, variance = min(least, share), self._variance[j]
            if last[j]:
                product = e * last[j] / variance
                products.append(min(max(product, -_MOST_SQUARED), _MOST_SQUARED))
            # Clipped, so that a payload change or an impact does not count as noise.
            change = share * (min(e * e, _MOST_SQUARED * variance) - variance)
            self._variance[j] = max(variance + change, self._least[j])
            self._last[j] = e
        mean = sum(products) / len(products) if products else 0.0
        self._correlation += least * (mean - self._correlation)
