"""Variance of an arm's values from one period to the next (moderated t statistics).

The variance of an arm is that of the fleet times a factor, which is distributed as 1/χ²
with d₀ degrees of freedom; d₀ is large if arms differ no more than by chance. The
estimate is the mean of the arm's own variance and the fleet's, weighted by their
degrees of freedom, and has the sum of both (Smyth 2004, doi 10.2202/1544-6115.1027). d₀
is estimated from all parameters together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.statistics import robust_std

_LOG_SQUARE = np.pi**2 / 2  # variance of the logarithm of a squared normal variable
_EXPONENT = 0.5, 0.5  # mean and standard deviation of its prior
_FREEDOM = 2 / 3  # degrees of freedom of N successive differences, over N
_MOST = 3.0  # robust standard deviations where a difference is clipped, for steps


def calibrated_std(parameters: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Standard deviations of the periods, calibrated on differences of the values.

    The stated ones come from one period alone. Their deviation from the arm's mean, in
    logarithms, is multiplied by an exponent from 0 to 1: the regression coefficient of
    the logarithms of squared differences, over all parameters. Each has values and
    standard deviations, shape (A, T).
    """
    mean, std = _EXPONENT
    weight = _LOG_SQUARE / std**2
    power, product = weight, weight * mean
    for y, s in parameters:
        for differences, size in (_differences(*x) for x in zip(y, s, strict=True)):
            moves = differences != 0
            if moves.any():
                x, u = 2 * np.log(size[moves]), 2 * np.log(np.abs(differences[moves]))
                power += float(((x - x.mean()) ** 2).sum())
                product += float((x - x.mean()) @ u)
    exponent = min(1.0, max(0.0, product / power))
    usual = [
        np.exp(np.nanmean(np.log(s), axis=1, keepdims=True)) for _, s in parameters
    ]
    pairs = zip(parameters, usual, strict=True)
    return [x * (s / x) ** exponent for (_, s), x in pairs]


@dataclass(frozen=True)
class Scatter:
    """Variance of one parameter from differences of successive values.

    Attributes:
        square: Mean squared difference of each arm over its stated variance, shape
            (A,); 0 without differences.
        freedom: Degrees of freedom of ``square``, shape (A,).
    """

    square: Array
    freedom: Array

    @classmethod
    def of(cls, y: Array, s: Array) -> Scatter:
        """From values and their standard deviations, shape (A, T); NaN if missing."""
        pairs = [_differences(*x) for x in zip(y, s, strict=True)]
        differences = [difference / size for difference, size in pairs]
        most = _MOST * robust_std(np.concatenate(differences))
        squares = [np.minimum(np.abs(x), most) ** 2 for x in differences]
        return cls(
            np.array([x.mean() if len(x) else 0.0 for x in squares]),
            _FREEDOM * np.array([len(x) for x in squares], dtype=np.float64),
        )

    @property
    def shares(self) -> Array:
        """Weight of each arm in the mean of the fleet, shape (A,)."""
        return self.freedom / max(float(self.freedom.sum()), 1e-9)

    @property
    def fleet(self) -> float:
        """Mean of ``square`` over all arms."""
        return max(float(self.shares @ self.square), 1e-18)


def moderated(parameters: Sequence[Scatter]) -> list[Scatter]:
    """Variance of each arm, shrunk towards that of the fleet."""
    excess, count = 0.0, 0.0
    for x in parameters:
        known = x.freedom > 0
        others = 1.0 - x.shares[known]
        squared = (x.square[known] / x.fleet - 1.0) ** 2
        excess += float((squared - others * 2.0 / x.freedom[known]).sum())
        count += float(others.sum())
    variation = max(0.0, excess / max(count, 1e-9))  # variance of the factor, 2/d₀
    return [_moderated(x, variation) for x in parameters]


def _moderated(x: Scatter, variation: float) -> Scatter:
    rest = np.maximum(x.freedom.sum() - x.freedom, 1e-9)
    prior = 2.0 / (variation + 2.0 / rest)
    freedom = x.freedom + prior
    return Scatter((x.freedom * x.square + prior * x.fleet) / freedom, freedom)


def _differences(y: Array, s: Array) -> tuple[Array, Array]:
    """Differences of successive values, and their standard deviations."""
    seen = np.isfinite(y) & np.isfinite(s)
    y, s = y[seen], s[seen]
    return np.diff(y), np.hypot(s[1:], s[:-1])
