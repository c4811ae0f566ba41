"""Random-effects pooling of one parameter over the arms of a group, with outliers.

The value of an arm is drawn from the fleet's distribution, N(μ, τ²), and measured with
its own variance: DerSimonian and Laird 1986, doi 10.1016/0197-2456(86)90046-2. The
estimate of one arm is shrunk towards the mean (Efron and Morris 1975, doi
10.1080/01621459.1975.10479864).
"""

import numpy as np
from scipy.special import stdtr

from hybrid.arrays import Array, Index, Mask

FEWEST = 4  # arms in a group
_FALSE_RATE = 0.01  # probability of any outlier in a group without one


def pooled(y: Array, s: Array) -> tuple[Array, Mask]:
    """Estimate of each of A arms, and whether it is an outlier, shape (A,) each.

    An arm is compared with the distribution of all others, at a level for all arms
    together (Holm), and outliers are removed one by one. An outlier keeps its own
    value. Values and their standard deviations, above zero, have the shape (A,).
    """
    unlike = np.zeros(len(y), dtype=bool)
    while (~unlike).sum() >= FEWEST:
        rest = np.flatnonzero(~unlike)
        p = np.array([_p_value(y, s, rest, k) for k in rest.tolist()])
        worst = int(np.argmin(p))
        if p[worst] * len(rest) >= _FALSE_RATE:
            break
        unlike[rest[worst]] = True
    mean, spread, _ = _mean_and_spread(y[~unlike], s[~unlike])
    weight = np.where(unlike, 1.0, spread**2 / (spread**2 + s**2))
    return weight * y + (1 - weight) * mean, unlike


def _p_value(y: Array, s: Array, rest: Index, k: int) -> float:
    """Probability of a value of arm k at least as far from the mean of the others."""
    others = rest[rest != k]
    mean, spread, error = _mean_and_spread(y[others], s[others])
    distance = abs(y[k] - mean) / np.hypot(np.hypot(spread, error), s[k])
    return float(2 * stdtr(max(len(others) - 1, 1), -distance))


def _mean_and_spread(y: Array, s: Array) -> tuple[float, float, float]:
    """Mean, standard deviation between arms, and standard error of the mean."""
    w = s**-2.0
    mean = (w @ y) / w.sum()
    spread = max(0.0, (w @ (y - mean) ** 2 - (len(y) - 1))
                 / max(w.sum() - (w**2).sum() / w.sum(), 1e-300))  # fmt: skip
    w = 1.0 / (s**2 + spread)
    return float((w @ y) / w.sum()), float(np.sqrt(spread)), float(w.sum() ** -0.5)
