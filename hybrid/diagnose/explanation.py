"""The terms that explain a gap, fitted together and scored on unseen samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.attribute import Search, Term
from hybrid.diagnose.background import background, clocks
from hybrid.diagnose.candidates import with_gains
from hybrid.diagnose.evidence import Evidence, Index, Solution
from hybrid.diagnose.gap import Gap, block_seconds
from hybrid.diagnose.refine import take_nudges
from hybrid.diagnose.shapes import shape_units
from hybrid.effects import Effect
from hybrid.robot.chain import Array

_BLOCK_SECONDS = 1.0
_OPEN = 10.0  # times a gain's prior deviation
_TAIL = 0.02  # of a term's squares: no more than a filter spreads
_ORDERS = 24  # of terms, and as many reversed


@dataclass(frozen=True, eq=False)
class Explanation:
    """Background and terms on the samples kept for scoring.

    Attributes:
        gap: The gap.
        terms: Effects with their shapes.
        evidence: Cross-products on the samples kept for scoring.
        index: Columns of background and terms.
        gains: Their values, found on the other samples.
        own: Columns of each term.
        learnt: The same on the samples that the gains were found on.
    """

    gap: Gap
    terms: tuple[Term, ...]
    evidence: Evidence
    index: Index
    gains: Array
    own: tuple[Index, ...]
    learnt: Explanation | None = None

    @cached_property
    def rigid(self) -> Index:
        """Columns of the background."""
        taken = np.concatenate([np.zeros(0, dtype=np.intp), *self.own])
        return np.setdiff1d(self.index, taken)

    def without(self, *terms: int) -> Array:
        """The gains with those of some terms at zero."""
        gains = self.gains.copy()
        for k in terms:
            gains[np.isin(self.index, self.own[k])] = 0.0
        return gains

    def left(self, gains: Array) -> list[Array]:
        """Residual of each joint, in the order of ``evidence.rows``, [N·m]."""
        n = self.gap.robot.size
        return [self.evidence.residual(i, self.index, gains) for i in range(n)]

    @cached_property
    def after(self) -> list[Array]:
        """Residual of each joint with all terms, [N·m]."""
        return self.left(self.gains)

    @cached_property
    def before(self) -> list[Array]:
        """Residual of each joint with the background alone, [N·m]."""
        return self.left(self.without(*range(len(self.terms))))

    def contribution(self, k: int) -> list[Array]:
        """Torque of one term at each joint, [N·m]."""
        return [
            w - a for w, a in zip(self.left(self.without(k)), self.after, strict=True)
        ]

    def members(self, effect_id: str) -> list[int]:
        """Terms that are of one effect."""
        return [k for k, t in enumerate(self.terms) if t.place[0] == effect_id]

    def kept(self, members: Sequence[int]) -> float:
        """Fall of the squares by some terms, over the fall if their torque were right.

        It is one on the mean for what is there, and zero for what is not.
        """
        left = self.left(self.without(*members))
        fall = promised = 0.0
        for x, y, noise in zip(left, self.after, self.evidence.noise, strict=True):
            fall += float(x @ x - y @ y) / noise
            promised += float((x - y) @ (x - y)) / noise
        return fall / promised if promised > 0 else 0.0

    def where_seen(self, members: Sequence[int]) -> Explanation:
        """This, or :attr:`learnt` if some terms hardly act on the scored samples.

        What happened only once cannot be checked on another occasion.
        """
        if self.learnt is None:
            return self
        here, there = (
            sum(float(part @ part) for k in members for part in x.contribution(k))
            for x in (self, self.learnt)
        )
        return self if here > _TAIL * there else self.learnt

    def blocks(self, i: int) -> NDArray[np.intp]:
        """Block of time of each scored sample of a joint, for resampling."""
        rows = self.evidence.rows[i]
        length = max(1, round(_BLOCK_SECONDS * self.gap.rate))
        return rows // length


def split(gap: Gap) -> NDArray[np.bool_]:
    """Samples to learn from, shape (M,); the others are for scoring only.

    Every fourth trajectory is kept for scoring; of fewer than four, every fourth block
    of time, less a sixth at both of its ends, which is used for nothing.
    """
    count = gap.trajectory.max() + 1
    if count >= 4:
        return np.asarray(gap.trajectory % 4 != 3)
    # Not the same one of each: trajectories often end alike.
    return np.asarray((gap.fold + gap.trajectory) % 4 != 3)


def between(gap: Gap, learn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples too near to those learnt from to be scored."""
    reach = round(block_seconds(gap.motions) / 6 * gap.rate)
    near = np.convolve(learn, np.ones(2 * reach + 1), mode="same") > 0
    apart = np.ones(len(learn), dtype=bool)
    if gap.trajectory.max() < 3:
        apart = ~near
    return apart


def explain(gap: Gap, search: Search, learn: NDArray[np.bool_]) -> Explanation:
    """Score what a search found on the samples it has not seen.

    Args:
        gap: The gap.
        search: A search that has run on the samples to learn from.
        learn: Those samples, shape (M,).
    """
    found = search.evidence.solve(search.base())
    evidence, index, own = _fresh(gap, search, ~learn & between(gap, learn))
    evidence.noise = search.evidence.noise
    terms = tuple(search.terms)
    learnt = Explanation(
        gap, terms, search.evidence, found.index, found.gains,
        tuple(t.index for t in terms),
    )  # fmt: skip
    return Explanation(gap, terms, evidence, index, found.gains, own, learnt)


def shares(search: Search, rng: np.random.Generator) -> Array:
    """Part of each term in what all of them explain, shape (terms,).

    Shapley's shares of the fall in squares, in units of noise, on the samples learnt
    from; every subset of terms is fitted anew, beside the background as it is with all
    of them: alone it would take over, at the price of numbers that are far off. They
    are estimated from random orders and their reverses, which settles the shares of
    two terms exactly.

    Source: Shapley 1953, doi 10.1515/9781400881970-018; Mitchell et al. 2022,
    arXiv 2104.12199 (antithetic orders).
    """
    evidence, terms = search.evidence, search.terms
    gain = np.zeros(len(terms))

    rigid, base = search.background, search.base()
    K = len(rigid)
    known = evidence.solve(base).gains[:K]
    A, b = evidence.normal(base)
    at = {int(k): i for i, k in enumerate(base)}

    def left(order: Sequence[int]) -> float:
        own = np.concatenate([np.zeros(0, dtype=np.intp)]
                             + [terms[i].index for i in order])  # fmt: skip
        here = [at[int(k)] for k in own]
        H = A[np.ix_(here, here)] + np.diag(evidence.precision[own])
        gains = np.linalg.solve(H, b[here] - A[here, :K] @ known)
        columns = np.concatenate([rigid, own])
        squares = evidence.squares(columns, np.concatenate([known, gains])).sum(axis=1)
        return float((squares / evidence.noise).sum())

    nothing = left([])
    for _ in range(_ORDERS if len(terms) > 2 else 1):
        forth = rng.permutation(len(terms)).tolist()
        for order in (forth, forth[::-1]):
            before = nothing
            for k in range(len(order)):
                after = left(order[: k + 1])
                gain[order[k]] += before - after
                before = after
    gain = np.maximum(gain, 0.0)
    return np.asarray(gain / max(gain.sum(), 1e-300))


@dataclass(frozen=True, eq=False)
class Refit:
    """The terms of a search on all samples: the numbers that are reported.

    Attributes:
        solution: Gains of background and terms at the shapes that were found.
        effects: The effects of the terms, with these gains and standard deviations.
            Those of gains take into account that shapes are not known exactly.
    """

    solution: Solution
    effects: tuple[Effect, ...]


def refit(gap: Gap, search: Search) -> Refit:
    """Fit the terms of a search to all samples."""
    evidence, index, own = _fresh(gap, search, np.ones(len(gap.fold), dtype=bool))
    evidence.noise = search.evidence.noise
    solution = evidence.solve(index)
    effects = [
        with_gains(t.candidate.effect, solution.of(i))
        for t, i in zip(search.terms, own, strict=True)
    ]
    shapes = [take_nudges(evidence, effect) for effect in effects]
    for i in own:
        # Values lean on their priors; what the data leave open the intervals show.
        evidence.spread(i, _OPEN)
    # Nor do these tell when between two samples torque was read.
    shifts = evidence.add(*clocks(gap))
    whole = evidence.solve(np.concatenate([solution.index, *shapes, *shifts]))
    place = {int(k): i for i, k in enumerate(whole.index)}
    certain = []
    for effect, i, s in zip(effects, own, shapes, strict=True):
        here = [place[int(k)] for k in (*i, *s)]
        unit = np.array([*np.ones(len(i)), *shape_units(gap, effect)])
        covariance = whole.covariance[np.ix_(here, here)] * np.outer(unit, unit)
        covariance[np.diag_indices(len(here))] += _between_samples(gap, effect)
        certain.append(_reported(effect, covariance))
    return Refit(solution, tuple(certain))


def _between_samples(gap: Gap, effect: Effect) -> Array:
    """Variance of a time at which something happens between two samples, shape (p,)."""
    numbers = [*effect.gains, *(x for x in effect.shapes if not x.whole)]
    step = 1.0 / gap.motions[0].rate
    return np.array([step**2 / 12.0 if x.unit == "s" else 0.0 for x in numbers])


def _reported(effect: Effect, covariance: Array) -> Effect:
    """An effect's law of the torque reported, with standard deviations."""
    names = [x.name for x in (*effect.gains, *effect.shapes) if not x.whole]
    law = effect.as_reported()
    if law is effect:
        std = np.sqrt(np.diag(covariance))
        return law.at({}, dict(zip(names, map(float, std), strict=True)))
    slopes = []
    for name, spread in zip(names, np.sqrt(np.diag(covariance)), strict=True):
        step = 1e-4 * float(spread) or 1e-9
        then = effect.at({name: effect.values[name] + step}).as_reported()
        slopes.append([(then.values[x] - law.values[x]) / step for x in names])
    J = np.array(slopes).T
    std = np.sqrt(np.diag(J @ covariance @ J.T))
    return law.at({}, dict(zip(names, map(float, std), strict=True)))


def _fresh(
    gap: Gap, search: Search, use: NDArray[np.bool_]
) -> tuple[Evidence, Index, tuple[Index, ...]]:
    evidence = Evidence(gap, use)
    rigid = np.concatenate(evidence.add(*background(gap)))
    evidence.spread(rigid, search.off)
    effects = [t.candidate for t in search.terms]
    own: tuple[Index, ...] = ()
    if effects:
        columns = [gap.columns(c.effect) for c in effects]
        own = tuple(evidence.add(columns, [c.std for c in effects]))
    return evidence, np.concatenate([rigid, *own]), own
