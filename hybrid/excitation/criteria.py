"""Optimality criteria: functions of the information G = Wᵀ W, with gradients.

All are logarithms, and smaller is better. The condition number has no gradient where
eigenvalues coincide, as they do at its optimum. So it is replaced by p-means of the
eigenvalues and of their inverses, which tend to the largest and the smallest eigenvalue
for large p (Kiefer 1974, doi 10.1214/aos/1176342810).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hybrid.arrays import Array

_FLOOR = 1e-15  # of the largest eigenvalue: smaller ones are rounding errors


class Criterion(Protocol):
    """A measure of the information of a motion; smaller is better."""

    def value(self, gram: Array) -> float:
        """The measure of the information, shape (b, b)."""
        return float(np.exp(self.smooth(gram, 1.0)[0]))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """Logarithm of the measure, and its derivative by G, shape (b, b).

        A larger power is nearer to the measure, but less smooth.
        """


@dataclass(frozen=True)
class Condition(Criterion):
    """Ratio of the largest to the smallest singular value of W."""

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        return gram_condition(gram)

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`."""
        eigenvalues, vectors = spectrum(gram)
        high, by_high = _log_mean(eigenvalues, power)
        low, by_low = _log_mean(1.0 / eigenvalues, power)
        slope = by_high / eigenvalues - by_low / eigenvalues
        return 0.5 * (high + low), 0.5 * (vectors * slope) @ vectors.T


@dataclass(frozen=True)
class DOptimal(Criterion):
    """Volume of the confidence ellipsoid: geometric mean of its axes, det(G)^(−1/2b).

    The best motion does not depend on the scale of the columns.
    """

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`; it is smooth, and ``power`` is not used."""
        eigenvalues, vectors = spectrum(gram)
        b = len(gram)
        value = -0.5 * float(np.log(eigenvalues).mean())
        return value, -0.5 / b * (vectors / eigenvalues) @ vectors.T


def gram_condition(gram: Array) -> float:
    """Condition number of W from G = Wᵀ W."""
    eigenvalues = spectrum(gram)[0]
    return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))


def spectrum(gram: Array) -> tuple[Array, Array]:
    """Eigenvalues, raised above rounding errors, and eigenvectors."""
    eigenvalues, vectors = np.linalg.eigh(gram)
    return np.maximum(eigenvalues, _FLOOR * eigenvalues[-1]), vectors


def _log_mean(x: Array, power: float) -> tuple[float, Array]:
    """Logarithm of (Σ xᵖ)^(1/p), and x times its derivative by x."""
    top = x.max()
    parts = (x / top) ** power
    total = parts.sum()
    return float(np.log(top) + np.log(total) / power), parts / total
