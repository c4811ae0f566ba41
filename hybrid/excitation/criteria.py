"""What makes a motion good: functions of its information G = Wᵀ W, with gradients.

All are logarithms, smaller is better, and share one smooth form. With eigenvalues λ of
G, the p-mean of their inverses is Kiefer's criterion (Kiefer 1974,
doi 10.1214/aos/1176342810): p → 0 gives the determinant, p = 1 the trace of the inverse
and p → ∞ the smallest eigenvalue. The last, and with it the condition number, has no
gradient where eigenvalues meet, and at its optimum they do; a large p has one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hybrid.errors import ExcitationError
from hybrid.robot.chain import Array

# Eigenvalues below this part of the largest are rounding.
_FLOOR = 1e-15


class Criterion(Protocol):
    """A measure of the information of a motion; smaller is better."""

    def value(self, gram: Array) -> float:
        """The measure itself, of information of shape (b, b)."""

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """Logarithm of the measure, and its derivative by G, shape (b, b).

        Args:
            gram: Information, shape (b, b).
            power: The larger, the nearer to the measure, and the more curved.
        """


@dataclass(frozen=True)
class Condition:
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
class NormalisedCondition:
    """Condition number of W with its columns brought to unit length."""

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        return gram_condition(normalised(gram))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`."""
        size = _sizes(gram)
        unit = gram / np.outer(size, size)
        value, slope = Condition().smooth(unit, power)
        # d(G_ij / s_i s_j), with s_i² = G_ii.
        by_size = (slope * unit).sum(axis=1) / size**2
        return value, slope / np.outer(size, size) - np.diag(by_size)


@dataclass(frozen=True)
class DOptimal:
    """Volume of the confidence ellipsoid: geometric mean of its axes, det(G)^(−1/2b).

    Whatever the scale of the columns, the same motion is best.
    """

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        return float(np.exp(self.smooth(gram, 1.0)[0]))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`; it is smooth as it is."""
        eigenvalues, vectors = spectrum(gram)
        b = len(gram)
        value = -0.5 * float(np.log(eigenvalues).mean())
        return value, -0.5 / b * (vectors / eigenvalues) @ vectors.T


@dataclass(frozen=True)
class AOptimal:
    """Root mean square of the standard errors, √(tr G⁻¹ / b)."""

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        return float(np.exp(self.smooth(gram, 1.0)[0]))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`; it is smooth as it is."""
        return _inverse_mean(gram, 1.0)


@dataclass(frozen=True)
class EOptimal:
    """Longest axis of the confidence ellipsoid, λ_min(G)^(−1/2)."""

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        return float(1.0 / np.sqrt(spectrum(gram)[0][0]))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`."""
        return _inverse_mean(gram, power)


@dataclass(frozen=True, eq=False)
class Discrimination:
    """How well a motion tells two candidate effects apart.

    If one candidate is there, a model with the other one, and everything else, leaves
    the lack of fit gᵀ ((G⁻¹)_AA)⁻¹ g, in units of noise variance (T-optimality,
    Atkinson and Fedorov 1975, doi 10.1093/biomet/62.1.57). The measure is the inverse
    root of the smaller of the two.

    Attributes:
        first: Unknowns of one candidate, indices.
        second: Unknowns of the other.
        gains: Sizes at which they shall be told apart, shape (b,), in the units of the
            scaled columns; only those of the candidates count.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    gains: Array

    def __post_init__(self) -> None:
        if not (self.first and self.second) or set(self.first) & set(self.second):
            raise ExcitationError(
                "two candidates need unknowns of their own to be told apart; those of "
                "one of them are no more than a combination of others"
            )

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        worst = max(self._squared(gram, at)[0] for at in (self.first, self.second))
        return float(np.sqrt(worst))

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`."""
        found = [self._squared(gram, at) for at in (self.first, self.second)]
        value, by = _log_mean(np.array([x for x, _ in found]), power)
        slope = sum(w * s / x for w, (x, s) in zip(by, found, strict=True))
        return 0.5 * value, 0.5 * np.asarray(slope)

    def _squared(self, gram: Array, at: tuple[int, ...]) -> tuple[float, Array]:
        """Inverse of the lack of fit and its derivative by G."""
        eigenvalues, vectors = spectrum(gram)
        inverse = (vectors / eigenvalues) @ vectors.T
        rows = inverse[list(at)]
        gains = self.gains[list(at)]
        direction = np.linalg.solve(rows[:, list(at)], gains)
        lack = float(gains @ direction)
        # d((G⁻¹)_AA)⁻¹ = K⁻¹ (G⁻¹ dG G⁻¹)_AA K⁻¹ with K = (G⁻¹)_AA.
        along = rows.T @ direction
        return 1.0 / lack, -np.outer(along, along) / lack**2


def gram_condition(gram: Array) -> float:
    """Condition number of W from G = Wᵀ W."""
    eigenvalues = spectrum(gram)[0]
    return float(np.sqrt(eigenvalues[-1] / eigenvalues[0]))


def normalised(gram: Array) -> Array:
    """G of columns of unit length."""
    size = _sizes(gram)
    return np.asarray(gram / np.outer(size, size))


def _sizes(gram: Array) -> Array:
    size = np.sqrt(gram.diagonal())
    return np.asarray(np.maximum(size, 1e-12 * size.max()))


def spectrum(gram: Array) -> tuple[Array, Array]:
    """Eigenvalues, none of them rounding, and eigenvectors."""
    eigenvalues, vectors = np.linalg.eigh(gram)
    return np.maximum(eigenvalues, _FLOOR * eigenvalues[-1]), vectors


def _log_mean(x: Array, power: float) -> tuple[float, Array]:
    """Logarithm of (Σ xᵖ)^(1/p), and x times its derivative by x."""
    top = x.max()
    parts = (x / top) ** power
    total = parts.sum()
    return float(np.log(top) + np.log(total) / power), parts / total


def _inverse_mean(gram: Array, power: float) -> tuple[float, Array]:
    eigenvalues, vectors = spectrum(gram)
    value, by = _log_mean(1.0 / eigenvalues, power)
    value -= np.log(len(gram)) / power
    slope = -0.5 * (vectors * (by / eigenvalues)) @ vectors.T
    return 0.5 * float(value), np.asarray(slope)
