"""Score the gap on held-out motions, and that of plain least squares beside it."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.diagnosis import Unseen
from hybrid.diagnosis.evidence.candidates import usual
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.explanations.physical import solve_physical
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.background import background
from hybrid.regression.least_squares import pseudo_solve

_FLAT = 1e3  # times the standard deviation of a prior: no prior at all
_NOISE = 1.5  # times the squares of noise: noise may leave so much on held-out motions


def unseen(search: Search, found: Account, named: Sequence[Cause]) -> Unseen:
    """Score a search, of which some causes are ``named``, on held-out motions."""
    test = search.test

    def rms(squares: Array) -> tuple[float, ...]:
        left = np.sqrt(np.maximum(squares, 0.0) / test.count)
        return tuple(map(float, left))

    return Unseen(
        before=rms(test.evidence.power),
        after=rms(_simulated(search, search.causes)),
        least_squares=rms(_least_squares(search)),
        ceiling=rms(test.squares(search.whole)),
        noise=tuple(map(float, np.sqrt(found.noise))),
        named=rms(_simulated(search, named)),
    )


def _simulated(search: Search, causes: Sequence[Cause]) -> Array:
    """Squares that a simulator with some causes leaves on held-out samples, (n,)."""
    # Its links are physical, and it has nothing of the background but numbers of a
    # file.
    columns, test = search.columns(causes), search.test
    effects = [(c.candidate.effect, c.index) for c in causes if c.candidate]
    chain = search.gap.robot.chain
    gains = solve_physical(search.evidence, chain, columns, effects).gains.copy()
    gains[np.isin(columns, np.setdiff1d(search.rigid, search.declared))] = 0.0
    return test.evidence.squares(test.columns(causes), gains)


def _least_squares(search: Search) -> Array:
    """Squares that least squares leaves on held-out samples, shape (n,), [N²·m²]."""
    gap, n = search.gap, search.gap.robot.size
    columns, spreads = background(gap)
    blocks, sizes = columns[:n], spreads[:n]  # the links
    for c in usual(gap):
        blocks.append(gap.columns(c.effect))
        sizes.append(c.std)
    train, test = Evidence(gap, search.learn), Evidence(gap, search.test.use)
    index, tested = (np.concatenate(x.add(blocks, sizes)) for x in (train, test))
    train.noise = train.power / np.maximum(train.count, 1) + 1e-12
    train.scale_prior(index, _FLAT)
    A, b = train.normal(index)
    gains = pseudo_solve(A + np.diag(train.precision[index]), b)
    return test.squares(tested, gains)


def left_unseen(scored: Explanation, found: Account) -> float:
    """Share of the gap above noise that an explanation leaves on held-out motions."""
    variance = np.maximum(found.noise, 1e-300)
    left = whole = 0.0
    for before, after, noise in zip(scored.before, scored.after, variance, strict=True):
        expected = _NOISE * len(after)
        rest = max(float(after @ after) / noise - expected, 0.0)
        left += rest
        whole += max(float(before @ before) / noise - expected, rest)
    return left / whole if whole > 0 else 0.0
