"""The most probable explanation of a gap.

An explanation is a set of causes. Its score is the log marginal likelihood of the gap,
with all gains integrated out under their priors, less the odds against each cause:

    log p(gap | causes) + Σ log p(cause).

Causes are effects of the library at places of the arm, and unknown laws of a joint. The
noise is that of the gap which no flexible regression removes, nor the explanation, and
the part of the gap by which any law of the library may be inexact. Each step has to
lower the squares on folds left out, and in the end each cause those on recordings that
the search has not learnt from.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import WIDER
from hybrid.diagnosis.evidence.candidates import Candidate, Place, usual
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.pool import Pool
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.refine import refine
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.evidence.term import Term
from hybrid.diagnosis.explanations.belief import Belief, beliefs
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.elsewhere import Elsewhere
from hybrid.diagnosis.explanations.laws import Laws
from hybrid.diagnosis.explanations.proposal import Proposal
from hybrid.diagnosis.explanations.weight import weigh
from hybrid.diagnosis.gap.background import background, clocks, rest
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.split import between
from hybrid.diagnosis.prior import Prior
from hybrid.effects import effect_classes

_RIPPLES = 9  # orders at each joint, of which noise is estimated
_ROUNDS = 4  # of adding, exchanging and widening
_MOST = 20  # causes
_REFUSALS = 6  # times that some causes are refused
_FEW = 3  # causes: an arm with more of them may have what most have
_BETTER = 0.5  # nat, for a change to be worth it


class Search:
    """Causes of a gap, added, exchanged and removed until nothing is gained.

    Args:
        gap: The gap.
        learn: Samples to learn from, shape (M,); all by default.
        without: Ids of effects to leave out of the library.
        prior: What is believed before any recording.
    """

    def __init__(
        self,
        gap: Gap,
        learn: NDArray[np.bool_] | None = None,
        without: Sequence[str] = (),
        prior: Prior | None = None,
    ) -> None:
        self.gap, self.prior = gap, prior or Prior()
        self.learn = np.ones(len(gap.fold), dtype=bool) if learn is None else learn
        self.evidence = Evidence(gap, self.learn)
        self.numbers = np.concatenate(self.evidence.add(*background(gap)))
        self.off = self.prior.file[1]
        self.evidence.spread(self.numbers, self.off)
        own = self.evidence.add(*rest(gap)) + self.evidence.add(*clocks(gap))
        self.rigid = np.concatenate([self.numbers, *own])
        self.pool = Pool(self.evidence, without)
        self.pool.take_ripples(self.rigid, _RIPPLES)
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        self.noise = self.evidence.noise.copy()
        self._weigh()
        self.pool.take_contacts(self.rigid)
        self.pool.take_steep(self.rigid)
        self.laws = Laws(self.evidence, self.rigid, self.prior)
        self.causes: list[Cause] = []
        self.refused: set[Place] = set()
        self.beliefs: list[Belief] = []  # of the known causes, once it has run
        self.whole: list[Cause] = []  # all causes, once it has run
        self.library_only = False

    def _weigh(self) -> None:
        """Let noise be what it is, and what no law and no simulator has exactly."""
        self.covariances = weigh(self.evidence, self.noise, self.rigid, self.prior)
        rigid = self.evidence.solve(self.rigid)
        self._whole = self.evidence.lost(rigid.index, rigid.gains) / 2
        self._kept: dict[tuple[object, ...], tuple[Candidate, float]] = {}
        self._last: dict[Cause, frozenset[Cause | bool]] = {}
        self.__dict__.pop("test", None)

    def mimicked(self, c: Cause | Candidate) -> float:
        """What a cause may be worth that is but the inexactness of another, [nat]."""
        known = isinstance(c, Candidate) or c.candidate is not None
        part = self.prior.inexact if known else self.prior.misfit
        return float(part**2 * self._whole[list(c.place[1])].max())

    def _odds(self, c: Cause) -> float:
        """Odds against a cause, [nat]."""
        return c.cost + self.mimicked(c)

    @property
    def known(self) -> list[Cause]:
        """The causes that are effects of the library."""
        return [c for c in self.causes if c.candidate is not None]

    @property
    def terms(self) -> list[Term]:
        """The same as effects with their columns."""
        return [Term(c.candidate, c.index) for c in self.causes if c.candidate]

    @property
    def background(self) -> Index:
        """Columns of what is no known cause: the file's numbers, and unknown laws."""
        unknown = [c.index for c in self.causes if c.candidate is None]
        return np.concatenate([self.rigid, *unknown])

    def base(self, without: Term | None = None) -> Index:
        """Columns of the whole explanation, or of all but one known cause."""
        parts = [
            t.index
            for t in self.terms
            if without is None or t.index is not without.index
        ]
        return np.concatenate([self.background, *parts])

    def having(self, chosen: Sequence[Candidate]) -> Search:
        """The same search with some effects as all of its causes."""
        other = copy(self)
        other.causes = [self.cause(c) for c in chosen]
        return other

    @property
    def widest(self) -> float:
        """How far off the file's numbers may be at least, where values are stated."""
        return max(self.off, self.prior.file[2])

    def ranked(self, base: Index) -> list[tuple[Candidate, float]]:
        """See :meth:`.Pool.ranked`."""
        there = [c for c in self.known if c.index[0] in base]
        return self.pool.ranked(base, self._taken(there))

    def _taken(self, causes: Sequence[Cause]) -> set[Place]:
        """Where no more may be than some causes: one of a kind, or a few."""
        most = self.prior.repeated
        count = Counter(c.place for c in causes)
        again = {x.id for x in effect_classes().values() if x.repeats}
        return {x for x, k in count.items() if k >= (most if x[0] in again else 1)}

    def refine(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`."""
        return refine(self.evidence, base, c)

    def loss(self, term: Term) -> float:
        """Evidence that would be lost without a term, [nat]."""
        whole, without = (self.evidence.solve(self.base(t)) for t in (None, term))
        lost = whole.evidence - without.evidence
        return float(lost - price(term.candidate.effect))

    def placed(self, found: Term | Candidate) -> tuple[str, str]:
        """The id of an effect, and the name of the joint that it is at."""
        effect_id, joints = found.place
        return effect_id, self.gap.robot.joints[joints[-1]]

    def columns(self, causes: Sequence[Cause]) -> Index:
        """Columns of the background and of some causes."""
        return np.concatenate([self.rigid, *(c.index for c in causes)])

    def score(self, causes: Sequence[Cause]) -> float:
        """Log posterior of an explanation, up to a constant, [nat]."""
        known = self.evidence.solve(self.columns(causes)).evidence
        return known - sum(map(self._odds, causes))

    def cause(self, c: Candidate) -> Cause:
        """An effect as a cause."""
        std = c.wider * c.std
        (index,) = self.evidence.add([self.gap.columns(c.effect)], [std])
        cost = self.prior.cause + price(c.effect) + float(np.log(c.wider))
        return Cause(c.place, index, cost, c)

    def run(self) -> list[Cause]:
        """The most probable explanation whose causes hold on unseen recordings."""
        self._settle()
        if len(self.known) < len(self.causes) or len(self.causes) > _FEW:
            self._start_again()
        self.beliefs = beliefs(self)
        if self._simplify() | self._unmask():
            self.beliefs = beliefs(self)
        self.whole = list(self.causes)
        return self.causes

    def _start_again(self) -> None:
        """Start from what most joints have, and keep the more probable explanation.

        One unknown law, or an effect that nearly fits, may have been taken in where two
        or three others belong.
        """
        before = self.causes, self.off
        self.causes, self.refused = self._with_usual([]), set()
        self._widen()
        self._listen()
        self._remove()
        for self.library_only in (True, False):
            self._settle()
        now = self.score(self.causes)
        self.evidence.spread(self.numbers, before[1])
        if self.score(before[0]) > now:
            self.causes = before[0]
            self._take(before[1])
        self.evidence.spread(self.numbers, self.off)

    def _with_usual(self, causes: Sequence[Cause]) -> list[Cause]:
        """Some causes and, under the most probable prior, what most joints have."""
        there = {c.place for c in causes}
        more = [c for c in usual(self.gap, self.pool.without) if c.place not in there]
        each = [[self.cause(replace(c, wider=w)) for c in more] for w in WIDER]
        return max(([*causes, *x] for x in each), key=self.score)

    def stand_in(self) -> None:
        """Let effects of the library stand in for unknown laws, as far as they help.

        A simulator has no other laws. They are no causes.
        """
        if all(c.candidate is not None for c in self.causes):
            return
        self.causes, self.library_only = self.known, True
        self.refused = set()
        usual = self._with_usual(self.causes)
        self.causes = max(self.causes, usual, key=self.score)
        self._remove()
        self._settle()

    def _settle(self) -> None:
        """Grow an explanation until all of its causes hold on unseen recordings."""
        for _ in range(_REFUSALS):
            self._grow()
            bad = [c for c, fall in self.unseen().items() if fall <= 0]
            if not bad and not self._listen():
                break
            self.refused |= {c.place for c in bad}
            self.causes = [c for c in self.causes if c not in bad]

    def _grow(self) -> None:
        for _ in range(_ROUNDS):
            changed = False
            while len(self.causes) < _MOST and self._add():
                changed = True
            for cause in list(self.causes):
                if cause in self.causes and self._last.get(cause) != self._near(cause):
                    if self._renew(cause):
                        changed = True
                    else:
                        self._last[cause] = self._near(cause)
            if not changed and not self._widen():
                break

    def _near(self, cause: Cause) -> frozenset[Cause | bool]:
        """What is at the same joints; what is at others hardly matters to a cause."""
        own = set(cause.place[1])
        near = (c for c in self.causes if own.intersection(c.place[1]))
        return frozenset([self.library_only, *near])

    def _widen(self) -> bool:
        """Let the file's numbers be as far off as is most probable."""

        def score(off: float) -> float:
            self.evidence.spread(self.numbers, off)
            far = np.log(off / self.prior.file[1]) / np.log(self.prior.file_factor)
            return float(self.score(self.causes) - 0.5 * far**2)

        def lost(off: float) -> Array:
            self.evidence.spread(self.numbers, off)
            return self._left_out(self.causes)

        now, best = self.off, max(self.prior.file, key=score)
        added = self.prior.cause * self.gap.robot.size  # each link is then another one
        wider = score(best) > score(now) + added
        wider = wider and bool(np.all(lost(best) < lost(now)))
        self.evidence.spread(self.numbers, now)
        if wider:
            self._take(best)
        return wider

    def _listen(self) -> bool:
        """Let noise be what the explanation leaves where that is less; whether it is.

        An explanation is one of the regressions that noise is what they leave of.
        """
        lower = self.evidence.lower_noise(self.noise, self.columns(self.causes))
        less = bool(np.any(lower != self.noise))
        if less:
            self.noise = lower
            self._weigh()
        return less

    def _take(self, off: float) -> None:
        """Take the file's numbers to be so far off; what is inexact is the rest."""
        self.off = off
        self.evidence.spread(self.numbers, off)
        self._weigh()

    def _add(self) -> bool:
        base = self.columns(self.causes)
        self.pool.take_ripples(base)
        self.pool.take_contacts(base)
        now = self.score(self.causes)
        for found in self.proposals(self.causes):
            if found.worth <= _BETTER:
                break
            causes = [*self.causes, found.make()]
            if self.score(causes) > now + _BETTER and self._holds(causes):
                self.causes = causes
                self._remove()
                return self.score(self.causes) > now + _BETTER
        return False

    def _holds(self, causes: Sequence[Cause]) -> bool:
        """Whether some causes lose less than those there are, on folds left out."""
        now, then = map(self._left_out, (self.causes, causes))
        return bool(np.all(then < now))

    def _left_out(self, causes: Sequence[Cause]) -> Array:
        """What some causes lose on each fold by the others, shape (2,), [nat]."""
        seen, columns = self.evidence, self.columns(causes)
        strain = seen.strain(seen.solve(columns), self.rigid)
        return np.asarray((seen.left_out(columns) + strain) / 2)

    def _remove(self) -> None:
        """Take out causes that are worth less than their odds."""
        while self.causes:
            now = self.score(self.causes)
            rest = [[x for x in self.causes if x is not c] for c in self.causes]
            worth = now - np.array([self.score(x) for x in rest])
            # What a rough law leaves out may look like any other cause, as large.
            left_out = np.array([c.rough**2 for c in self.causes]) * worth
            needed = [np.delete(left_out, k).max(initial=0.0) for k in range(len(rest))]
            weakest = int(np.argmin(worth - needed))
            if worth[weakest] >= needed[weakest]:
                return
            self.causes = rest[weakest]

    def _renew(self, cause: Cause) -> bool:
        """Exchange a cause for whatever explains most in its place, or for nothing."""
        now = self.score(self.causes)
        rest = [c for c in self.causes if c is not cause]
        alone = self.score(rest)
        for found in self.proposals(rest, own=cause)[:2]:
            if alone + found.worth > now + _BETTER:
                causes = [*rest, found.make()]
                if self.score(causes) > now + _BETTER and self._holds(causes):
                    self.causes = causes
                    self._remove()
                    return True
        if alone > now:
            self.causes = rest
            return True
        return False

    def proposals(
        self, causes: Sequence[Cause], own: Cause | None = None
    ) -> list[Proposal]:
        """What may be added to some causes, and by how much it raises the score.

        Args:
            causes: The causes.
            own: A cause that is not among them, whose shapes are fitted anew.
        """
        base, found = self.columns(causes), list[Proposal]()
        whole, less = base, base[:0]
        if own is not None and own in self.causes:
            whole, less = self.columns(self.causes), own.index
        ranked = self.pool.ranked(whole, self._taken(causes), less)
        ranked = [(c, x) for c, x in ranked if c.place not in self.refused]
        ranked = ranked[: self.prior.shortlist]
        short = [c for c, x in ranked if x > self.prior.refined * ranked[0][1]]
        if own is not None and own.candidate is not None:
            short = [own.candidate, *short]
        for c in short:
            better, worth = self._refined(base, c)
            make = partial(self.cause, better)
            odds = self.prior.cause + self.mimicked(c)
            found.append(Proposal(c.place, worth - odds, make, better))
        laws = self.laws.open(causes)
        if laws and not self.library_only:
            found.append(self._unknown(laws, base, whole, less))
        return sorted(found, key=lambda x: -x.worth)

    def _unknown(
        self, laws: Sequence[Cause], base: Index, whole: Index, less: Index
    ) -> Proposal:
        """The best of some unknown laws beside a base, which is a whole less a part."""
        every = self.laws.all  # the same ones each time, whose products are kept
        none = [np.full(len(x.index), -np.inf) for x in every]
        gained = self.evidence.screen(whole, [x.index for x in every], none, less=less)
        known = dict(zip(every, gained, strict=True))
        law = max(laws, key=lambda x: known[x] - self._odds(x))
        make = partial(self.laws.widened, base, law)
        return Proposal(law.place, float(known[law]) - self._odds(law), make)

    def _refined(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`; kept, for the same is asked again and again."""
        shapes = tuple(c.effect.values.items())
        key = base.tobytes(), self.off, c.place, shapes
        if key not in self._kept:
            self._kept[key] = refine(self.evidence, base, c)
        return self._kept[key]

    def _simplify(self) -> bool:
        """Exchange causes for plainer ones that are as probable; whether there are."""
        before = list(self.causes)
        for belief in self.beliefs:
            plain = belief.plainest(_BETTER)
            if plain is not None:
                self.causes[self.causes.index(belief.cause)] = plain.make()
        return self.causes != before

    def _unmask(self) -> bool:
        """Let unknown laws take the place of laws at their limits; whether there are.

        A law there is another one, which would be in its place if anybody knew it.
        """
        masks = [
            b.cause for b in self.beliefs
            if b.limit is not None and b.cause in self.causes
        ]  # fmt: skip
        for cause in masks:
            self.causes = [c for c in self.causes if c is not cause]
            laws = self.laws.open(self.causes)
            laws = [x for x in laws if x.place[1][0] in cause.place[1]]
            if laws:
                base = self.columns(self.causes)
                law = self._unknown(laws, base, base, base[:0])
                self.causes.append(law.make())
            self._remove()
        return bool(masks)

    def unseen(self) -> dict[Cause, float]:
        """By how much each known cause lowers the squares on unseen samples, [nat].

        As they are and as independent samples: the less of both. Without it all others
        are fitted anew. Numbers of the file that take its place are farther off: that
        counts as much as before any recording.
        """
        if not self.known:
            return {}
        whole, without = self._lost(self.causes), dict[Cause, float]()
        for c in self.known:
            fall = self._lost([x for x in self.causes if x is not c]) - whole
            without[c] = float(fall.min())
        return without

    @cached_property
    def test(self) -> Elsewhere:
        """The samples kept for scoring."""
        return Elsewhere(self, ~self.learn & between(self.gap, self.learn))

    def columns_of(self, cause: Cause) -> Columns:
        """Torque per unit of each gain of a cause at every sample, by joint."""
        if cause.candidate is None:
            return self.laws.columns(cause)
        return self.gap.columns(cause.candidate.effect)

    def _lost(self, causes: Sequence[Cause]) -> Array:
        """What some causes lose on unseen samples, less what a fit says, [nat].

        With samples as independent ones, and as they are: shape (2,).
        """
        seen, unseen = self.evidence, self.test.evidence
        lost = self.test.lost(causes), self.test.squares(causes) / seen.noise
        # As if as much were unseen as was learnt from.
        more = seen.count.sum() / max(unseen.count.sum(), 1)
        strain = seen.strain(seen.solve(self.columns(causes)), self.rigid)
        return np.asarray((np.sum(lost, axis=1) * more + strain) / 2)
