"""The gap on motions that no step has seen, beside what could be had without us."""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Unseen
from hybrid.diagnosis.evidence.candidates import usual
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.background import background
from hybrid.regression.least_squares import pseudo_solve

_FREE = 1e3  # times the size of a number: nothing is known of it before
_BEYOND = 1.5  # times the squares of noise: what is more on unseen motions is none


def unseen(search: Search, found: Account) -> Unseen:
    """Score an explanation, and what could be had without it.

    Args:
        search: A search that has run.
        found: Its account.
    """
    test = search.test

    def rms(squares: Array) -> tuple[float, ...]:
        left = np.sqrt(np.maximum(squares, 0.0) / test.count)
        return tuple(map(float, left))

    return Unseen(
        before=rms(test.evidence.power),
        after=rms(test.squares(search.causes)),
        least_squares=rms(_least_squares(search)),
        ceiling=rms(test.squares(search.whole)),
        noise=tuple(map(float, np.sqrt(found.noise))),
    )


def _least_squares(search: Search) -> Array:
    """Squares that least squares leaves on unseen samples, shape (n,), [N²·m²]."""
    gap, n = search.gap, search.gap.robot.size
    columns, spreads = background(gap)
    blocks, sizes = columns[:n], spreads[:n]  # the links
    for c in usual(gap):
        blocks.append(gap.columns(c.effect))
        sizes.append(c.std)
    seen, other = Evidence(gap, search.learn), Evidence(gap, search.test.use)
    index, there = (np.concatenate(x.add(blocks, sizes)) for x in (seen, other))
    seen.noise = seen.power / np.maximum(seen.count, 1) + 1e-12
    seen.scale_prior(index, _FREE)
    A, b = seen.normal(index)
    gains = pseudo_solve(A + np.diag(seen.precision[index]), b)
    return other.squares(there, gains)


def left_unseen(scored: Explanation, found: Account) -> float:
    """Part of the gap that is left on unseen motions, where that is not noise.

    What is explained where it was learnt may not be explained elsewhere.
    """
    variance = np.maximum(found.noise, 1e-300)
    left = whole = 0.0
    for before, after, noise in zip(scored.before, scored.after, variance, strict=True):
        usual = _BEYOND * len(after)
        rest = max(float(after @ after) / noise - usual, 0.0)
        left += rest
        whole += max(float(before @ before) / noise - usual, rest)
    return left / whole if whole > 0 else 0.0
