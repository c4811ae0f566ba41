"""The known causes of a gap, fitted together and scored on test samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.candidates import Term
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.explanations.other_samples import TAIL
from hybrid.diagnosis.explanations.physical import solve_physical
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import seconds

_INSTEAD = 0.7  # of the fall of a declared law, least gain of the law in its place
_ORDERS = 24  # random orders of terms, each with its reverse


@dataclass(frozen=True, eq=False)
class Explanation:
    """Background and terms on the test samples.

    Attributes:
        gap: The gap.
        terms: Effects with their shapes.
        evidence: Cross-products on the test samples.
        index: Columns of background and terms.
        gains: Their gains, fitted to the training samples.
        own: Columns of each term.
        learnt: The same on the training samples.
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
        return self.evidence.residuals(self.index, gains)

    @cached_property
    def after(self) -> list[Array]:
        """Residual of each joint with all terms, [N·m]."""
        return self.left(self.gains)

    @cached_property
    def before(self) -> list[Array]:
        """Residual of each joint with the background alone, [N·m]."""
        return self.left(self.without(*range(len(self.terms))))

    def contribution(self, k: int) -> list[Array]:
        """Torque of a term at each joint, [N·m]."""
        pairs = zip(self.left(self.without(k)), self.after, strict=True)
        return [without - after for without, after in pairs]

    @cached_property
    def named(self) -> tuple[str, ...]:
        """Id of the effect under which each term is reported.

        A declared law that is reduced is reported under the law that takes its place.
        """
        first = [self.gains[self.index == own[0]].item() for own in self.own]

        def owner(k: int) -> str:
            law, joints = self.terms[k].place
            for other, gain in zip(self.terms, first, strict=True):
                plain = other.candidate.effect.becomes
                place = plain[2] if plain else "", other.place[1]
                if (
                    place == (law, joints)
                    and first[k] < 0 < _INSTEAD * -first[k] < gain
                ):
                    return other.place[0]
            return law

        return tuple(map(owner, range(len(self.terms))))

    def members(self, effect_id: str) -> list[int]:
        """Terms that are reported under an effect."""
        return [k for k, name in enumerate(self.named) if name == effect_id]

    def where_seen(self, members: Sequence[int]) -> Explanation:
        """This, or :attr:`learnt` if some terms hardly act on the test samples.

        An effect that acts only once cannot be tested.
        """
        if self.learnt is None:
            return self
        here, there = (
            sum(float(part @ part) for k in members for part in x.contribution(k))
            for x in (self, self.learnt)
        )
        return self if here > TAIL * there else self.learnt

    def blocks(self, i: int) -> Index:
        """Block of time of each test sample of a joint, for the bootstrap."""
        return seconds(self.gap)[self.evidence.rows[i]]


def explain(search: Search) -> Explanation:
    """Score the known causes of a search on its test samples."""
    gap, terms, test = search.gap, tuple(search.terms), search.test
    test.evidence.scale_prior(test.numbers, search.file_error)
    seen, unseen = search.columns(search.known), test.columns(search.known)
    effects = [(t.candidate.effect, t.index) for t in terms]
    chain, base = gap.robot.chain, search.base()
    gains = solve_physical(search.evidence, chain, base, effects).of(seen)
    learnt = Explanation(
        gap, terms, search.evidence, seen, gains, tuple(t.index for t in terms)
    )
    own = tuple(map(test.own, search.known))
    return Explanation(gap, terms, test.evidence, unseen, gains, own, learnt)


def shares(search: Search, rng: np.random.Generator) -> Array:
    """Share of each term in what all of them explain, shape (terms,).

    Shapley values of the fall in squares, in units of noise, on the training samples.
    Each subset of terms is refitted, while the background stays as it is with all of
    them. The values are estimated from random orders and their reverses, which is exact
    for two terms.

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

    @cache  # orders share their first terms
    def left(some: frozenset[int]) -> float:
        own = np.concatenate([np.zeros(0, dtype=np.intp)]
                             + [terms[i].index for i in sorted(some)])  # fmt: skip
        here = [at[int(k)] for k in own]
        H = A[np.ix_(here, here)] + np.diag(evidence.precision[own])
        gains = np.linalg.solve(H, b[here] - A[here, :K] @ known)
        columns = np.concatenate([rigid, own])
        both = np.concatenate([known, gains])
        return float(evidence.weighted_squares(columns, both).sum())

    none = left(frozenset())
    for _ in range(_ORDERS if len(terms) > 2 else 1):
        forth = rng.permutation(len(terms)).tolist()
        for order in (forth, forth[::-1]):
            before = none
            for k in range(len(order)):
                after = left(frozenset(order[: k + 1]))
                gain[order[k]] += before - after
                before = after
    gain = np.maximum(gain, 0.0)
    return np.asarray(gain / max(gain.sum(), 1e-300))
