"""What arms of one kind have in common, and which of them is unlike the others.

The value of an arm is drawn from the fleet's distribution, N(μ, τ²), and measured with
its own variance: DerSimonian and Laird 1986, doi 10.1016/0197-2456(86)90046-2. The best
guess of one arm lies between its own value and the mean (Efron and Morris 1975, doi
10.1080/01621459.1975.10479864).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from hybrid.arrays import Array

FEWEST = 4  # arms that make a fleet
_UNLIKE = 0.01  # chance to name any arm of a fleet of one kind


@dataclass(frozen=True)
class Pooled:
    """One parameter over the arms of a group.

    Attributes:
        value: Best guess of each arm, shape (A,).
        std: Its standard deviation, shape (A,).
        unlike: Arms that are not of this fleet, shape (A,).
    """

    value: Array
    std: Array
    unlike: NDArray[np.bool_]


def pooled(y: Array, s: Array) -> Pooled:
    """Pool values of A arms; those unlike the rest are taken out one by one.

    An arm is held against the distribution of all others, at a level for all arms
    together (Holm); one that is unlike keeps its own value.

    Args:
        y: Values, shape (A,).
        s: Their standard deviations, shape (A,), above zero.
    """
    unlike = np.zeros(len(y), dtype=bool)
    while (~unlike).sum() >= FEWEST:
        rest = np.flatnonzero(~unlike)
        p = np.array(
            [_strange(y[k], s[k], *_without(y, s, rest, k)) for k in rest.tolist()]
        )
        worst = int(np.argmin(p))
        if p[worst] * len(rest) >= _UNLIKE:
            break
        unlike[rest[worst]] = True
    mean, spread, error = _between(y[~unlike], s[~unlike])
    own = np.where(unlike, 1.0, spread**2 / (spread**2 + s**2))
    std = np.sqrt(own * s**2 + (1 - own) ** 2 * error**2)
    return Pooled(own * y + (1 - own) * mean, std, unlike)


def _without(
    y: Array, s: Array, rest: NDArray[np.intp], k: int
) -> tuple[float, float, int]:
    others = rest[rest != k]
    mean, spread, error = _between(y[others], s[others])
    return mean, float(np.hypot(spread, error)), len(others)


def _strange(y: float, s: float, mean: float, spread: float, count: int) -> float:
    """Chance of a value as far from the others' mean."""
    far = abs(y - mean) / np.hypot(spread, s)
    return float(2 * student.sf(far, max(count - 1, 1)))


def _between(y: Array, s: Array) -> tuple[float, float, float]:
    """Mean, standard deviation between arms, and standard error of the mean."""
    w = s**-2.0
    mean = (w @ y) / w.sum()
    spread = max(0.0, (w @ (y - mean) ** 2 - (len(y) - 1))
                 / max(w.sum() - (w**2).sum() / w.sum(), 1e-300))  # fmt: skip
    w = 1.0 / (s**2 + spread)
    return float((w @ y) / w.sum()), float(np.sqrt(spread)), float(w.sum() ** -0.5)
