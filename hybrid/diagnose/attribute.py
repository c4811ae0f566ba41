"""Which effects explain the gap: forward-backward selection by evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import Candidate, fuller, mere, simpler, with_gains
from hybrid.diagnose.evidence import Evidence, Index
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.pool import REPEATED, Pool
from hybrid.diagnose.refine import gain, refine, shape_steps
from hybrid.diagnose.shapes import at_places, places, price
from hybrid.diagnose.term import Term
from hybrid.effects import Effect
from hybrid.effects.contact import Contact
from hybrid.effects.payload import LinkInertia
from hybrid.robot.chain import Array

_WORTH = 10.0  # nats that a term must add
_LEAST_REMOVED = 0.015  # of the RMS at a term's joints, on folds left out
_RIPPLES = 9  # orders tried at each joint at first
_SHORTLIST = 4
_MOST_TERMS, _MOST_THERE = 40, 9  # in all, and at one joint
_NEAR = 10.0
_POLISHINGS, _SETTLED = 4, 0.1  # passes, at most; nats that are worth another
_MENDING = 0.015  # of the evidence for the largest term at a joint
_MENDING_ROUGH = 0.2  # if the law of that one holds roughly, and in time at that
_FAR = 0.5  # of the gain that columns are made at
_SAME = 0.01  # of it: no matter
_ONE = 0.9  # of the evidence for two forms of one law, by one of them
_ALIKE = 3.0  # nats that do not settle which of two effects it is
# Sizes of the background that are tried: one standard deviation, relative.
_OFF = (0.003, 0.01, 0.03)
WIDEST = _OFF[-1]


class Search:
    """The terms found so far, and everything that might be added.

    Args:
        gap: The gap.
        use: Samples to learn from, shape (M,); all by default.
        without: Ids of effects to leave out of the library.
    """

    def __init__(
        self,
        gap: Gap,
        use: NDArray[np.bool_] | None = None,
        *,
        without: Sequence[str] = (),
    ) -> None:
        self.gap = gap
        self.evidence = Evidence(gap, use)
        self.background = np.concatenate(self.evidence.add(*background(gap)))
        self.pool = Pool(self.evidence, without)
        self.terms: list[Term] = []
        self._gone: set[tuple[str, tuple[int, ...]]] = set()  # came, and did not stay
        self.off = WIDEST
        self.evidence.spread(self.background, self.off)
        self.pool.take_ripples(self.background, _RIPPLES)
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        # In units of noise; without them it would hold them.
        self.pool.take_contacts(self.background)
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        # Where the file's numbers may be far off, these would seem to be the cause.
        self.evidence.spread(self.background, _OFF[0])
        self.pool.take_steep(self.background)
        self.evidence.spread(self.background, self.off)

    def having(self, chosen: Sequence[Candidate]) -> Search:
        """The same with other terms, of shapes as they are."""
        other = copy(self)
        other.terms = [self._term(c) for c in chosen]
        return other

    def run(self) -> list[Term]:
        """Terms for the background that makes the gap most probable.

        Not one so small that what numbers of the file are off by becomes a term.
        """
        found, usable = [], []
        for off in _OFF:
            self.evidence.spread(self.background, off)
            self._grow()
            total = self.evidence.solve(self.base()).evidence
            total -= sum(_WORTH + price(t.candidate.effect) for t in self.terms)
            found.append((total, off, self.terms))
            if not self._any_mere(off):
                usable.append(found[-1])
        _, self.off, self.terms = max(usable or found[-1:], key=lambda x: x[0])
        self.evidence.spread(self.background, self.off)
        self.prune()
        self._scan()
        self._polish()
        self._settle()
        self._remove()  # what mended shapes that were short of their best
        return self.terms

    def _any_mere(self, off: float) -> bool:
        """Whether a term is no more than what a number of the file is off by.

        Of a link, whose numbers are many: whether a wider background makes do without.
        """
        evidence, robot = self.evidence, self.gap.robot
        solution = evidence.solve(self.base())
        effects = [
            with_gains(t.candidate.effect, solution.of(t.index)) for t in self.terms
        ]
        links = [t for t in self.terms if t.place[0] == LinkInertia.id]
        evidence.spread(self.background, WIDEST)
        idle = any(self.loss(t) < _WORTH for t in links)
        evidence.spread(self.background, off)
        return idle or any(mere(robot, e) for e in effects)

    def _grow(self) -> None:
        """Add, improve, exchange and remove terms until nothing is gained."""
        self.terms, self._gone = [], set()
        for _ in range(_MOST_TERMS):
            before = list(self.terms)
            there = Counter(t.place[1][-1] for t in before)
            if max(there.values(), default=0) > _MOST_THERE or not self._add():
                break
            came = self.terms[-1]
            self._remove()
            if self.terms == before:  # what comes is what goes
                self._gone.add(came.place)
        self._gone = set()
        for _ in range(2):
            if not self._exchange():
                break
            self._remove()

    # Columns

    def base(self, without: Term | None = None) -> Index:
        """Columns of the background and of all terms, or all but one."""
        parts = [t.index for t in self.terms if t is not without]
        return np.concatenate([self.background, *parts])

    # Steps

    def _add(self) -> bool:
        self.pool.take_ripples(self.base())
        self.pool.take_contacts(self.base())
        best = self.best(self.base())
        if best is None or best[1] < _WORTH:
            return False
        self.terms.append(self._term(best[0]))
        return True

    def _term(self, c: Candidate) -> Term:
        (index,) = self.evidence.add([self.gap.columns(c.effect)], [c.std])
        return Term(c, index)

    def best(self, base: Index) -> tuple[Candidate, float] | None:
        """The candidate that adds most evidence, with its shapes fitted.

        A law gives way to the simpler one that it becomes at a bound of its shapes, and
        to one that explains the sign of its gain better; a link that would be another
        one altogether, to whatever explains half as much.
        """
        refined: list[tuple[Candidate, float]] = []
        top = _WORTH
        for c, first in self.ranked(base):
            if first <= 0.5 * top or len(refined) == _SHORTLIST:
                break
            found = self.refine(base, c)
            if all(found[0].effect.holds(motion) for motion in self.gap.motions):
                top = top if refined else first
                refined.append(found)
        if not refined:
            return None
        refined = [x for x in refined if self._likely(base, x[0])] or refined
        best, most = max(refined, key=lambda x: x[1])
        name, slack = simpler(best.effect)
        near = [
            x for x in refined
            if x[0].place == (name, best.effect.joints)
            and x[1] > most - max(_ALIKE, slack * most)
        ]  # fmt: skip
        return near[0] if near else (best, most)

    def _likely(self, base: Index, c: Candidate) -> bool:
        columns = self.gap.columns(c.effect)
        return c.likely(self.evidence.trial(base, columns, c.std, c.lower)[1])

    def ranked(self, base: Index) -> list[tuple[Candidate, float]]:
        """See :meth:`.Pool.ranked`."""
        taken = {t.place for t in self.terms if t.index[0] in base}
        ranked = self.pool.ranked(base, taken)
        return [x for x in ranked if x[0].place not in self._gone]

    def refine(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`."""
        return refine(self.evidence, base, c)

    def loss(self, term: Term) -> float:
        """Evidence that would be lost without a term, [nat]."""
        whole = self.evidence.solve(self.base()).evidence
        without = self.evidence.solve(self.base(term)).evidence
        return whole - without - price(term.candidate.effect)

    def _remove(self) -> None:
        while self.terms:
            losses = np.array([self.loss(t) for t in self.terms])
            # Beside a large one at the same joint, a small term mends an inexact law.
            least = [
                max(_mending(t, o) * x for o, x in zip(self.terms, losses, strict=True)
                    if o.place[1][-1] == t.place[1][-1] or t.place[0] == Contact.id)
                for t in self.terms
            ]  # fmt: skip
            margin = losses - np.maximum(least, _WORTH)
            weakest = int(np.argmin(margin))
            if margin[weakest] >= 0:
                return
            del self.terms[weakest]

    def prune(self) -> None:
        """Remove terms that hardly lower the squares on folds left out.

        Without a term the others are fitted anew, but for the background: it could
        take over, at the price of numbers that are far off.
        """
        evidence, rigid = self.evidence, self.background
        while self.terms:
            gains = evidence.by_fold(self.base())
            whole = evidence.squares(self.base(), gains).sum(axis=1)
            known, worth = gains[:, : len(rigid)], []
            for term in self.terms:
                base = self.base(term)
                rest = evidence.by_fold(base[len(rigid) :], rigid, known)
                without = evidence.squares(base, rest).sum(axis=1)
                fall = (without - whole) / evidence.noise
                main = fall >= 0.2 * fall.max()
                left = max(without[main].sum(), 1e-300)
                part = 1.0 - np.sqrt(whole[main].sum() / left)
                worth.append(min(fall.sum() / _WORTH, part / _LEAST_REMOVED))
                if self._is_rare(term):
                    worth[-1] = self.loss(term) / (2 * _WORTH)
            weakest = int(np.argmin(worth))
            if worth[weakest] >= 1.0:
                return
            del self.terms[weakest]

    def _is_rare(self, term: Term) -> bool:
        """Whether a term happened once; or now and then, and mends no other's law."""
        if self.evidence.folds_with(term.index) == 1:
            return True
        own = self.loss(term)
        return term.place[0] == Contact.id and all(
            self.loss(t) < own for t in self.terms if t is not term
        )

    def _scan(self) -> None:
        """Exchange the shapes of a term for others that fit better, however far.

        All that were tried are refined. Laws of more than one shape often fit about as
        well at places far apart.
        """
        for k, term in enumerate(list(self.terms)):
            effect = term.candidate.effect
            if not effect.steep and effect.id not in REPEATED and effect.shapes:
                self._exchange_for(k, [term.candidate, *self.pool.at(term.place)])

    def reform(self) -> bool:
        """Exchange laws for fuller ones that fit better; whether any was.

        What a law left may have been another's, that is gone.
        """
        before = list(self.terms)
        for k, term in enumerate(before):
            place = fuller(term.candidate.effect), term.place[1]
            if all(t.place != place for t in before):
                self._exchange_for(k, self.pool.at(place))
        return self.terms != before

    def _exchange_for(self, k: int, starts: Sequence[Candidate]) -> None:
        """Exchange a term for the best of some candidates, refined, if it is better."""
        base = self.base(self.terms[k])
        refined = [self.refine(base, c) for c in starts]
        best = max(refined, key=lambda x: x[1], default=None)
        if best is not None and best[1] > self.loss(self.terms[k]) + _ALIKE:
            self.terms[k] = self._term(best[0])

    def _polish(self) -> None:
        """Fit the shapes of all terms together, by Gauss-Newton steps.

        One after the other, on a grid and near it, leaves them short of the optimum.
        """
        for _ in range(_POLISHINGS):
            before, terms = self._worth(), self.terms
            placed = [(t.candidate, t.index) for t in terms]
            steps = shape_steps(self.evidence, self.base(), placed)
            for part in (1.0, 0.3):
                self.terms = [
                    self._moved(t, part * s) if len(s) else t
                    for t, s in zip(terms, steps, strict=True)
                ]
                if self._worth() > before:
                    break
            else:
                self.terms = terms
                return
            if self._worth() < before + _SETTLED:
                return

    def _settle(self) -> None:
        """Make the columns of effects on signals at the gains that all terms have."""
        for _ in range(_POLISHINGS):
            gains = self.evidence.solve(self.base())
            far = [
                k for k, t in enumerate(self.terms)
                if _linearised(t.candidate.effect)
                and abs(gains.of(t.index)[0] / t.candidate.effect.gain_values[0] - 1.0)
                > _SAME
            ]  # fmt: skip
            for k in far:
                c = self.terms[k].candidate
                effect = with_gains(c.effect, gains.of(self.terms[k].index))
                self.terms[k] = self._term(replace(c, effect=effect))

    def _worth(self) -> float:
        return self.evidence.solve(self.base()).evidence

    def _moved(self, term: Term, steps: Array) -> Term:
        effect = term.candidate.effect
        effect = at_places(self.gap, effect, places(self.gap, effect) + steps)
        return self._term(replace(term.candidate, effect=effect))

    def _exchange(self) -> bool:
        """Fit each term anew beside the others, as whatever explains most there."""
        changed = False
        for term in list(self.terms):
            if term not in self.terms:
                continue
            if self._merge(term):
                changed = True
                continue
            base = self.base(term)
            own, now = self.refine(base, term.candidate)
            best = self.best(base)
            if best is not None and best[1] > now + _ALIKE:
                own, now = best
            before = self.loss(term) if self._holds_gain(term) else -np.inf
            if now > before + 0.5:
                self.terms[self.terms.index(term)] = self._term(own)
                changed = changed or own.place != term.place or now > before + 3.0
        return changed

    def _holds_gain(self, term: Term) -> bool:
        """Whether a term's gain is near the one that its columns are made at.

        Those of an effect on signals are not linear: far off they are another law's.
        """
        effect = term.candidate.effect
        if not _linearised(effect):
            return True
        (made,) = effect.gain_values
        (now,) = self.evidence.solve(self.base()).of(term.index)
        return bool(abs(now - made) <= _FAR * abs(made))

    def _merge(self, term: Term) -> bool:
        """Let a term take over what another at the same joint explains.

        Two effects that are alike to first order may have been taken in one by one.
        """
        for other in [t for t in self.terms if t is not term]:
            if other.place[1] != term.place[1] or other.place == term.place:
                continue
            rest = [t.index for t in self.terms if t is not term and t is not other]
            base = np.concatenate([self.background, *rest])
            whole = self.evidence.solve(self.base()).evidence
            wanted = whole - self.evidence.solve(base).evidence - _WORTH
            if simpler(term.candidate.effect) == (other.place[0], 0.0):
                wanted *= _ONE  # a law and what it becomes at a bound of its shapes
            if gain(self.evidence, base, term.candidate) < wanted - _NEAR:
                continue
            alone, found = self.refine(base, term.candidate)
            if found > wanted:
                self.terms = [t for t in self.terms if t is not term and t is not other]
                self.terms.append(self._term(alone))
                return True
        return False


def _mending(small: Term, large: Term) -> float:
    """Part of a term's evidence that another one needs, not to mend its law.

    Play and springs are right but for when a link lands or swings: a delay makes up.
    """
    effect = small.candidate.effect
    late = (effect.observes or effect.reports) and not effect.steep
    rough = late and large.candidate.effect.steep
    return _MENDING_ROUGH if rough else _MENDING


def _linearised(effect: Effect) -> bool:
    """Whether an effect's columns are made at its gain, and hold near it."""
    signal = effect.observes or effect.reports
    one = len(effect.gains) == 1 and effect.gain_values[0] != 0.0
    return signal and one and not effect.steep
