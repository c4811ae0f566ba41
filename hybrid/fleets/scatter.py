"""How far the values of an arm scatter from one period to the next.

The variance of an arm is the fleet's times a factor of its own, distributed as 1/χ²
with d₀ degrees of freedom: many where arms differ by no more than chance. The best
guess is the mean of the arm's own and the fleet's, weighted by their degrees of
freedom, and a score has as many as both (moderated t, Smyth 2004, doi
10.2202/1544-6115.1027). d₀ is of all parameters together: one of them tells little of
how arms differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array

_LOG_SQUARE = np.pi**2 / 2  # variance of the logarithm of a normal square
_TRUST = 0.5, 0.5  # mean and standard deviation of it before any period is known
_FREEDOM = 2 / 3  # of a mean square of N successive differences, over N
_MOST = 3.0  # usual sizes that a difference counts at most: a step is no scatter


def tempered(parameters: Sequence[tuple[Array, Array]]) -> list[Array]:
    """Standard deviations of the periods, as far as they tell the noise of each.

    They are guesses of one period alone. About each arm's mean their logarithms count
    by as much as those of squared differences follow them, over all parameters.

    Args:
        parameters: Values and standard deviations of each, shape (A, T).
    """
    mean, std = _TRUST
    weight = _LOG_SQUARE / std**2
    known, follows = weight, weight * mean
    for y, s in parameters:
        for gaps, size in (_differences(*x) for x in zip(y, s, strict=True)):
            moves = gaps != 0
            if moves.any():
                x, u = 2 * np.log(size[moves]), 2 * np.log(np.abs(gaps[moves]))
                known += float(((x - x.mean()) ** 2).sum())
                follows += float((x - x.mean()) @ u)
    trust = min(1.0, max(0.0, follows / known))
    usual = [
        np.exp(np.nanmean(np.log(s), axis=1, keepdims=True)) for _, s in parameters
    ]
    pairs = zip(parameters, usual, strict=True)
    return [x * (s / x) ** trust for (_, s), x in pairs]


@dataclass(frozen=True)
class Scatter:
    """What differences of successive values say of one parameter.

    Attributes:
        square: Mean square of those of each arm, over what the standard deviations
            say, shape (A,); 0 where there are none.
        freedom: Degrees of freedom of that, shape (A,).
    """

    square: Array
    freedom: Array

    @classmethod
    def of(cls, y: Array, s: Array) -> Scatter:
        """That of values and their standard deviations, shape (A, T); NaN is none."""
        pairs = [_differences(*x) for x in zip(y, s, strict=True)]
        gaps = [gap / size for gap, size in pairs]
        every = np.abs(np.concatenate(gaps))
        most = _MOST * 1.4826 * np.median(every) if len(every) else 0.0
        squares = [np.minimum(np.abs(x), most) ** 2 for x in gaps]
        return cls(
            np.array([x.mean() if len(x) else 0.0 for x in squares]),
            _FREEDOM * np.array([len(x) for x in squares], dtype=np.float64),
        )

    @property
    def shares(self) -> Array:
        """Part of each arm in what is known of the fleet, shape (A,)."""
        return self.freedom / max(float(self.freedom.sum()), 1e-9)

    @property
    def fleet(self) -> float:
        """Mean square of all arms."""
        return max(float(self.shares @ self.square), 1e-18)


def moderated(parameters: Sequence[Scatter]) -> list[Scatter]:
    """Variance of each arm given the fleet's, and its degrees of freedom."""
    spread, count = 0.0, 0.0
    for x in parameters:
        known = x.freedom > 0
        others = 1.0 - x.shares[known]
        off = (x.square[known] / x.fleet - 1.0) ** 2
        spread += float((off - others * 2.0 / x.freedom[known]).sum())
        count += float(others.sum())
    differ = max(0.0, spread / max(count, 1e-9))  # variance of the factor, 2/d₀
    return [_moderated(x, differ) for x in parameters]


def _moderated(x: Scatter, differ: float) -> Scatter:
    rest = np.maximum(x.freedom.sum() - x.freedom, 1e-9)
    prior = 2.0 / (differ + 2.0 / rest)
    freedom = x.freedom + prior
    return Scatter((x.freedom * x.square + prior * x.fleet) / freedom, freedom)


def _differences(y: Array, s: Array) -> tuple[Array, Array]:
    """Differences of successive values, and their standard deviations."""
    seen = np.isfinite(y) & np.isfinite(s)
    y, s = y[seen], s[seen]
    return np.diff(y), np.hypot(s[1:], s[:-1])
