"""The most probable explanation of a gap.

An explanation is a set of causes. Its score is the log marginal likelihood of the gap,
with all gains integrated out under their priors, less the odds against each cause:

    log p(gap | causes) + Σ log p(cause).

Causes are effects of the library at places of the arm, and unknown laws of a joint. The
noise is that of the gap which no flexible regression removes, by its memory, and the
part of the gap by which any law of the library may be inexact. A cause has to lower the
squares on recordings that the search has not seen.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from copy import copy
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.background import background, clocks, rest
from hybrid.diagnosis.bayes import memory
from hybrid.diagnosis.candidates import Candidate, Place, same
from hybrid.diagnosis.evidence import Evidence
from hybrid.diagnosis.explanations.belief import Belief
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.elsewhere import Elsewhere
from hybrid.diagnosis.explanations.proposal import Proposal
from hybrid.diagnosis.explanations.unknown import WAVES, unknown_laws, waves
from hybrid.diagnosis.gap import Columns, Gap
from hybrid.diagnosis.pool import Pool
from hybrid.diagnosis.prior import Prior
from hybrid.diagnosis.products import Index
from hybrid.diagnosis.refine import refine
from hybrid.diagnosis.shapes import price
from hybrid.diagnosis.split import between
from hybrid.diagnosis.term import Term

_RIPPLES = 9  # orders at each joint, of which noise is estimated
_ROUNDS = 4  # of adding, exchanging and widening
_MOST = 30  # causes, and times that some are refused
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
        self._waves: dict[Place, Array] = {}
        self.laws = [law for j in range(gap.robot.size) for law in self._wavy_laws(j)]
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        self._add_inexactness()
        self.pool.take_contacts(self.rigid)
        self.pool.take_steep(self.rigid)
        self.laws += [law for j in range(gap.robot.size) for law in self._laws(j)]
        self.causes: list[Cause] = []
        self.refused: set[Place] = set()
        self.beliefs: list[Belief] = []  # of the known causes, once it has run
        self.whole: list[Cause] = []  # all causes, once it has run
        self.library_only = False

    def _add_inexactness(self) -> None:
        """No law explains its part of a gap exactly, and no simulator all torque.

        What they leave is as slow as what they are of.
        """
        evidence, rigid = self.evidence, self.evidence.solve(self.rigid)
        self.noise = evidence.noise.copy()
        for i, rows in enumerate(evidence.rows):
            if not len(rows):
                continue
            back = np.argsort(rows)
            left = evidence.residual(i, rigid.index, rigid.gains)[back]
            torque = self.gap.measured[rows[back], i]
            parts = (
                (left, self.prior.inexact),
                (torque - torque.mean(), self.prior.solver),
            )
            for x, part in parts:
                evidence.noise[i] += part**2 * np.mean(x**2) * memory(x, rows[back])

    def _wavy_laws(self, joint: int) -> Iterator[Cause]:
        """Waves that stand out of what the background leaves, picked out of many."""
        evidence, rows = self.evidence, self.evidence.rows[joint]
        if not len(rows):
            return
        found = evidence.solve(self.rigid)
        left = evidence.residual(joint, found.index, found.gains)
        for name, x in waves(self.gap, joint, left, rows):
            if x.shape[1]:
                self._waves[name, (joint,)] = x
                picked = WAVES * np.log(len(rows))
                yield self._law(name, joint, x, self.prior.unknown + float(picked))

    def _laws(self, joint: int) -> Iterator[Cause]:
        if len(self.evidence.rows[joint]):
            for name, x in unknown_laws(self.gap, joint):
                yield self._law(name, joint, x, self.prior.unknown)

    def _law(self, name: str, joint: int, x: Array, cost: float) -> Cause:
        rows, torque = self.evidence.rows[joint], self.gap.scales[joint].torque
        size = np.sqrt(np.mean(x[rows] ** 2, axis=0)) + 1e-12
        std = self.prior.size * torque / size / np.sqrt(x.shape[1])
        (index,) = self.evidence.add([{joint: x}], [std])
        return Cause((name, (joint,)), index, cost)

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
        taken = {c.place for c in self.known if c.index[0] in base}
        return self.pool.ranked(base, taken)

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
        return known - sum(c.cost for c in causes)

    def cause(self, c: Candidate) -> Cause:
        """An effect as a cause."""
        (index,) = self.evidence.add([self.gap.columns(c.effect)], [c.std])
        return Cause(c.place, index, self.prior.cause + price(c.effect), c)

    def run(self) -> list[Cause]:
        """The most probable explanation whose causes hold on unseen recordings."""
        self._settle()
        if len(self.known) < len(self.causes):
            self._start_again()
        self.beliefs = self._believe()
        if self._simplify():
            self.beliefs = self._believe()
        self.whole = list(self.causes)
        return self.causes

    def _start_again(self) -> None:
        """Start from effects of the library, and keep the more probable explanation.

        One unknown law may have been taken in where two or three known ones belong.
        """
        before = self.score(self.causes), self.causes, self.off
        self.causes, self.refused = [], set()
        for self.library_only in (True, False):
            self._settle()
        if self.score(self.causes) < before[0]:
            _, self.causes, self.off = before
            self.evidence.spread(self.numbers, self.off)

    def stand_in(self) -> None:
        """Let effects of the library stand in for unknown laws, as far as they help.

        A simulator has no other laws. They are no causes.
        """
        if all(c.candidate is not None for c in self.causes):
            return
        self.causes, self.library_only = self.known, True
        self.refused = set()
        self._settle()

    def _settle(self) -> None:
        """Grow an explanation until all of its causes hold on unseen recordings."""
        for _ in range(_MOST):
            self._grow()
            bad = [c for c, fall in self.unseen().items() if fall <= 0]
            if not bad:
                break
            self.refused |= {c.place for c in bad}
            self.causes = [c for c in self.causes if c not in bad]

    def _grow(self) -> None:
        for _ in range(_ROUNDS):
            changed = False
            while len(self.causes) < _MOST and self._add():
                changed = True
            for cause in list(self.causes):
                if cause in self.causes:
                    changed |= self._renew(cause)
            if not changed and not self._widen():
                break

    def _widen(self) -> bool:
        """Let the file's numbers be as far off as is most probable."""

        def score(off: float) -> float:
            self.evidence.spread(self.numbers, off)
            far = np.log(off / self.prior.file[1]) / np.log(self.prior.file_factor)
            return float(self.score(self.causes) - 0.5 * far**2)

        now, best = self.off, max(self.prior.file, key=score)
        # A small remainder of an inexact law is no ground for changing all numbers.
        whole = score(now) - self.evidence.solve(self.rigid).evidence
        added = max(self.prior.cause, self.prior.rough * whole)
        self.off = best if score(best) > score(now) + added else now
        self.evidence.spread(self.numbers, self.off)
        return self.off != now

    def _add(self) -> bool:
        base = self.columns(self.causes)
        self.pool.take_ripples(base)
        self.pool.take_contacts(base)
        now = self.score(self.causes)
        for found in self.proposals(self.causes)[:2]:
            if found.worth <= _BETTER:
                break
            causes = [*self.causes, found.make()]
            if self.score(causes) > now + _BETTER:
                self.causes = causes
                self._remove()
                return self.score(self.causes) > now + _BETTER
        return False

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
                if self.score(causes) > now + _BETTER:
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
        ranked = [c for c, _ in self.pool.ranked(base, {c.place for c in causes})]
        ranked = [c for c in ranked if c.place not in self.refused]
        short = ranked[: self.prior.shortlist]
        if own is not None and own.candidate is not None:
            short = [own.candidate, *short]
        for c in short:
            better, worth = refine(self.evidence, base, c)
            make = partial(self.cause, better)
            found.append(Proposal(c.place, worth - self.prior.cause, make, better))
        laws = self._open_laws(causes)
        if laws and not self.library_only:
            none = [np.full(len(x.index), -np.inf) for x in laws]
            gained = self.evidence.screen(base, [x.index for x in laws], none)
            k = int(np.argmax(gained))
            law, gain = laws[k], float(gained[k]) - laws[k].cost
            found.append(Proposal(law.place, gain, lambda: law))
        return sorted(found, key=lambda x: -x.worth)

    def _open_laws(self, causes: Collection[Cause]) -> list[Cause]:
        """Unknown laws that are not among some causes, where there are few yet."""
        full = [
            sum(c.candidate is None and c.place[1] == (j,) for c in causes)
            >= self.prior.unknown_laws
            for j in range(self.gap.robot.size)
        ]
        return [x for x in self.laws if x not in causes and not full[x.place[1][0]]]

    def _believe(self) -> list[Belief]:
        """How probable each known cause is, and what might stand in its place."""
        now, found = self.score(self.causes), []
        for cause in self.known:
            rest = [c for c in self.causes if c is not cause]
            worth = now - self.score(rest)
            options: dict[Place, Proposal] = {}
            for x in self.proposals(rest, own=cause):
                options.setdefault(x.place, x)
            twins = {place for place, x in options.items() if self._twin(cause, x)}
            found.append(Belief.of(cause, worth, options, twins, self.prior.alike))
        return found

    def _twin(self, cause: Cause, other: Proposal) -> bool:
        """Whether something else has the same torque, and but another prior."""
        one, two = cause.candidate, other.candidate
        if one is None or two is None or one.place[1] != two.place[1]:
            return False
        return same(*(self.gap.columns(c.effect) for c in (one, two)))

    def unknown_worth(self, cause: Cause) -> float:
        """What the unknown laws are worth at the joint that a cause is about, [nat]."""
        evidence, causes = self.evidence, self.causes
        gains = evidence.solve(self.columns(causes)).of(cause.index)
        order = np.argsort(cause.index)
        joint = int(np.argmax(evidence.made(cause.index[order], gains[order])))
        rest = [c for c in causes if c.candidate is not None or c.place[1] != (joint,)]
        return self.score(causes) - self.score(rest)

    def _simplify(self) -> bool:
        """Exchange causes for plainer ones that are as probable; whether there are."""
        before = list(self.causes)
        for belief in self.beliefs:
            plain = belief.plainest(_BETTER)
            if plain is not None:
                self.causes[self.causes.index(belief.cause)] = plain.make()
        return self.causes != before

    def unseen(self) -> dict[Cause, float]:
        """By how much each known cause lowers the squares on unseen samples, [nat].

        Without it all others are fitted anew. Numbers of the file that take its place
        are farther off: that counts as much as before any recording.
        """
        if not self.known:
            return {}
        whole = self._lost(self.causes)
        return {
            c: self._lost([x for x in self.causes if x is not c]) - whole
            for c in self.known
        }

    @cached_property
    def test(self) -> Elsewhere:
        """The samples kept for scoring."""
        return Elsewhere(self, ~self.learn & between(self.gap, self.learn))

    def columns_of(self, cause: Cause) -> Columns:
        """Torque per unit of each gain of a cause at every sample, by joint."""
        if cause.candidate is not None:
            return self.gap.columns(cause.candidate.effect)
        (joint,) = cause.place[1]
        if (x := self._waves.get(cause.place)) is None:
            x = dict(unknown_laws(self.gap, joint))[cause.place[0]]
        return {joint: x}

    def _lost(self, causes: Sequence[Cause]) -> float:
        """What some causes lose on unseen samples, less what a fit says, [nat]."""
        seen, unseen = self.evidence, self.test.evidence
        lost = float((self.test.squares(causes) / seen.noise).sum())
        # As if as much were unseen as was learnt from.
        lost *= seen.count.sum() / max(unseen.count.sum(), 1)
        strain = seen.strain(seen.solve(self.columns(causes)), self.rigid)
        return float(lost + strain) / 2
