"""The terms that explain a gap, fitted together and scored on unseen samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.attribute import Search
from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import instead
from hybrid.diagnose.evidence import Evidence
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.measure import block_seconds
from hybrid.diagnose.products import Index
from hybrid.diagnose.term import Term
from hybrid.robot.chain import Array

_BLOCK_SECONDS = 1.0
_TAIL = 0.02  # of a term's squares: no more than a filter spreads
_FAR_LARGER = 10.0  # times the mean squares
_INSTEAD = 0.7  # of what is less of a law, at least of the one that takes its place
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

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Id of the effect that each term belongs to.

        Less of a law that the file declares belongs to the one that takes its place.
        """
        first = [self.gains[self.index == own[0]].item() for own in self.own]

        def owner(k: int) -> str:
            law, joints = self.terms[k].place
            for other, gain in zip(self.terms, first, strict=True):
                place = instead(other.candidate.effect), other.place[1]
                if (
                    place == (law, joints)
                    and first[k] < 0 < _INSTEAD * -first[k] < gain
                ):
                    return other.place[0]
            return law

        return tuple(map(owner, range(len(self.terms))))

    def members(self, effect_id: str) -> list[int]:
        """Terms that belong to one effect."""
        return [k for k, name in enumerate(self.named) if name == effect_id]

    def kept(self, members: Sequence[int]) -> tuple[float, float]:
        """Fall of the squares by some terms, over the fall if their torque were right.

        It is one on the mean for what is there, zero for what is half as large, and −1
        for what is not.

        Returns:
            That part, and its standard deviation by noise.
        """
        left = self.left(self.without(*members))
        fall = promised = 0.0
        for x, y, noise in zip(left, self.after, self.evidence.noise, strict=True):
            fall += float(x @ x - y @ y) / noise
            promised += float((x - y) @ (x - y)) / noise
        if promised <= 0:
            return 0.0, 0.0
        return fall / promised, 2.0 / promised**0.5

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
    of time, less a sixth at both of its ends, which is used for nothing. It is others
    if those alone hold what is far larger than anything that is left to learn from.
    """
    part, count = gap.trajectory, gap.trajectory.max() + 1
    masks = [part % 4 != k for k in (3, 2, 1, 0)]
    if count < 4:
        part = gap.fold * count + gap.trajectory
        # Not the same block of each: trajectories often end alike. Nor none at all.
        masks = [
            (gap.fold + turn * gap.trajectory + more) % 4 != 3
            for more in range(4) for turn in (1, 2, 0)
        ]  # fmt: skip
        masks = [x for x in masks if x.any() and not x.all()] or masks[:1]
    most = _unusual(gap, part)
    alone = [most[~x].max(initial=0.0) / most[x].max(initial=1e-300) for x in masks]
    chosen = 0 if alone[0] < _FAR_LARGER else int(np.argmin(alone))
    return np.asarray(masks[chosen])


def _unusual(gap: Gap, part: NDArray[np.intp]) -> Array:
    """Mean squares of a sample's part over those of a usual one, shape (M,).

    Of the joint at which that is most.
    """
    parts, own = np.unique(part, return_inverse=True)
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    mean = np.stack([
        squares[own == k].sum(axis=0) / np.maximum(gap.moving[own == k].sum(axis=0), 1)
        for k in range(len(parts))
    ])  # fmt: skip
    usual = np.maximum(np.median(mean, axis=0), 1e-300)
    return np.asarray((mean / usual).max(axis=1)[own])


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
    evidence, index, own = fresh(gap, search, ~learn & between(gap, learn))
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


def fresh(
    gap: Gap, search: Search, use: NDArray[np.bool_]
) -> tuple[Evidence, Index, tuple[Index, ...]]:
    """Evidence of other samples for the background and terms of a search.

    Args:
        gap: The gap.
        search: The search.
        use: The samples, shape (M,).

    Returns:
        The evidence, all columns, and those of each term.
    """
    evidence = Evidence(gap, use)
    rigid = np.concatenate(evidence.add(*background(gap)))
    evidence.spread(rigid, search.off)
    effects = [t.candidate for t in search.terms]
    own: tuple[Index, ...] = ()
    if effects:
        columns = [gap.columns(c.effect) for c in effects]
        own = tuple(evidence.add(columns, [c.std for c in effects]))
    return evidence, np.concatenate([rigid, *own]), own
