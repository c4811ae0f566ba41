"""Size and correlation of torque errors, tracked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.robot.chain import Array

_MEMORY = 5.0  # s
_FIRST = 20  # updates over which the first guess counts
_MOST_CORRELATED = 0.98


class TorqueNoise:
    """Fading mean square of the errors of each joint, and how far one repeats itself.

    Args:
        std: First guess of the standard deviation, shape (n,), [N·m].
        rate: Updates per second, [Hz].
    """

    def __init__(self, std: Array, rate: float) -> None:
        self._first = np.array(std, dtype=float) ** 2
        self._variance = self._first.copy()
        self._last = np.zeros_like(self._first)
        self._count = np.zeros_like(self._first)
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

    def update(self, used: NDArray[np.bool_], error: Array) -> None:
        """Take in errors of the joints that are used, at unit leverage, [N·m]."""
        self._count[used] += 1
        share = np.maximum(self._slowest, 1.0 / (_FIRST + self._count[used]))
        variance, last = self._variance[used], self._last[used]
        # Cut, so that a change or a blow does not pass for noise.
        square = np.minimum(error**2, 9.0 * variance)
        self._variance[used] = (1.0 - share) * variance + share * square
        self._variance = np.maximum(self._variance, 1e-12 * self._first)
        both = np.clip(error * last / variance, -9.0, 9.0)
        mean = float(both[last != 0].mean()) if np.any(last != 0) else 0.0
        self._lagged += float(share.min()) * (mean - self._lagged)
        self._last[:] = 0.0
        self._last[used] = error
