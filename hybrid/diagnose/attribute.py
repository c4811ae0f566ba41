"""Which effects explain the gap: forward-backward selection by evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

import numpy as np

from hybrid.diagnose.candidates import (
    HARDLY,
    Place,
    fuller,
    mere,
    plainer,
    simpler,
    with_gains,
)
from hybrid.diagnose.fitting import Fitting
from hybrid.diagnose.model import ALIKE, MENDING_ROUGH, OFF, WIDEST, WORTH
from hybrid.diagnose.names import name_plainly
from hybrid.diagnose.refine import gain
from hybrid.diagnose.term import Term
from hybrid.effects.contact import Contact
from hybrid.effects.payload import LinkInertia

_LEAST_REMOVED = 0.015  # of the RMS at a term's joints, on folds left out
_MOST_TERMS, _MOST_THERE = 40, 9  # in all, and at one joint
_ROUNDS = 3  # of adding, exchanging and removing
_LAWS = 3  # that are added at a joint beside a plain one
_NEAR = 10.0
_LESS = 0.1  # of the noise: worth another search
_SPARE = 50.0  # nats: all other numbers of a file are seldom far less off than usual
_ONE = 0.9  # of the evidence for two forms of one law, by one of them


class Search(Fitting):
    """How terms are found: added, exchanged and removed."""

    def run(self) -> list[Term]:
        """Terms for the background that makes the gap most probable.

        Not one so small that what numbers of the file are off by becomes a term.
        """
        self._grow()
        first, less = self.terms, self.evidence.lower_noise(self.base())
        found, usable = [], []
        for off in OFF:
            self.assume(off)
            if off < WIDEST or less > _LESS:
                self._grow()
            else:
                self.terms = first
            spare = _SPARE if self._links_spare() else 0.0
            found.append((self.total() - spare, off, self.terms))
            if not self._any_mere():
                usable.append(found[-1])
        _, off, self.terms = max(usable or found[-1:], key=lambda x: x[0])
        self.assume(off)
        before = list(self.terms)
        self._simplify(before)
        self._simplify([t for t in self.terms if t not in before])
        self.prune()
        self.fit_together()
        self.widen()
        kept = list(self.terms)
        self.loosen()
        self.remove()  # what mended shapes that were short of their best
        if len(self.terms) < len(kept):
            self.fit_together()  # what stays was fitted beside what is gone
        name_plainly(self)
        return self.terms

    def _any_mere(self) -> bool:
        """Whether a term is no more than what a number of the file is off by."""
        solution = self.evidence.solve(self.base())
        effects = [
            with_gains(t.candidate.effect, solution.of(t.index)) for t in self.terms
        ]
        return any(mere(self.gap.robot, e) for e in effects)

    def _links_spare(self) -> bool:
        """Whether the widest background makes do without a link, of many numbers."""
        links = [t for t in self.terms if t.place[0] == LinkInertia.id]
        with self.assuming(WIDEST):
            return any(self.loss(t) < WORTH for t in links)

    def _grow(self) -> None:
        """Add, improve, exchange and remove terms until nothing is gained.

        What seemed to mend a law may be wanted once that is another.
        """
        self.terms, places = [], set[Place]()
        for _ in range(_ROUNDS):
            self._extend()
            before, changed = places, self._exchange()
            self.remove()
            places = {t.place for t in self.terms}
            if not changed or places == before:
                break

    def _extend(self, without: Collection[Place] = ()) -> None:
        """Add terms, but for some, until nothing is gained."""
        self.gone = set(without)
        for _ in range(_MOST_TERMS):
            before = list(self.terms)
            there = Counter(t.place[1][-1] for t in before)
            if max(there.values(), default=0) > _MOST_THERE or not self._add():
                break
            came = self.terms[-1]
            self.remove()
            if self.terms == before:  # what comes is what goes
                self._share(came)
                if came not in self.terms:
                    self.terms = before
                    self.gone.add(came.place)
        self.gone = set()

    def _add(self) -> bool:
        self.pool.take_ripples(self.base())
        self.pool.take_contacts(self.base())
        best = self.best(self.base())
        if best is None or best[1] < WORTH:
            return False
        self.terms.append(self.term(best[0]))
        return True

    def _simplify(self, terms: Sequence[Term]) -> None:
        """Let some laws give way to plainer ones, alone or with others."""
        for term in terms:
            if term in self.terms:
                self._give_way(term)

    def _give_way(self, term: Term) -> None:
        """Exchange a law for the plainer one, or for several, if that explains more.

        What was found first may have taken the part of others at its joint, and a law
        of several joints that of one at each.
        """
        before, least, joints = self.terms, self.total(), term.place[1]
        others = [t for t in before if t is not term]
        place = plainer(term.candidate.effect), joints
        plain = [c for c in self.pool.at(place) if self.holds(c)]
        if len(joints) > 1:
            self.terms = others
            self._extend({term.place})
        elif plain and all(t.place != place for t in others):
            hardly = max(ALIKE, HARDLY * self.loss(term))
            self.terms = [*others, self.term(plain[0])]
            if self.total() > least - hardly:
                return
            away = [t for t in others if t.place[1] != joints]
            self.terms = [*away, self.term(plain[0])]
            if len(away) < len(others):
                self._fill(joints)
        if self.total() < least + ALIKE:
            self.terms = before

    def _fill(self, joints: tuple[int, ...]) -> None:
        """Add laws at some joints, fit them anew beside each other, remove the idle."""
        for _ in range(_LAWS):
            best = self.best(self.base(), joints)
            if best is None or best[1] < WORTH:
                break
            self.terms.append(self.term(best[0]))
        for _ in range(2):
            for term in [t for t in self.terms if t.place[1] == joints]:
                self.renew(term)
        self.remove()

    def _share(self, came: Term) -> None:
        """Add a small term and fit the largest at its joint anew, which had its part.

        What went as it mends a law may be one of two that the law stood for.
        """
        there = [t for t in self.terms if t.place[1] == came.place[1]]
        large = max(there, key=self.loss, default=None)
        self.terms = [*self.terms, came]
        if large is not None and self.renew(large):
            self.remove()
        else:
            self.terms.remove(came)

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
                worth.append(min(fall.sum() / WORTH, part / _LEAST_REMOVED))
                if self._is_rare(term):
                    worth[-1] = self.loss(term) / (2 * WORTH)
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

    def _exchange(self) -> bool:
        """Fit each term anew beside the others, as whatever explains most there."""
        changed = False
        for term in list(self.terms):
            if term not in self.terms:
                continue
            changed |= self._merge(term) or self.renew(term)
        return changed

    def _merge(self, term: Term) -> bool:
        """Let a term take over what another at the same joint explains.

        Two effects that are alike to first order may have been taken in one by one.
        """
        for other in [t for t in self.terms if t is not term]:
            if other.place[1] != term.place[1] or other.place == term.place:
                continue
            rest = [t.index for t in self.terms if t is not term and t is not other]
            base = np.concatenate([self.background, *rest])
            both = self.worth() - self.evidence.solve(base).evidence
            late = all(t.candidate.effect.differentiates for t in (term, other))
            wanted = both - max(WORTH, MENDING_ROUGH * both if late else 0.0)
            if fuller(other.candidate.effect) == term.place[0]:
                wanted *= _ONE  # a law and what it becomes at a bound of its shapes
            own = term.candidate
            quick = not own.effect.linearised  # right near its own gains only
            if quick and gain(self.evidence, base, own) < wanted - _NEAR:
                continue
            alone, found = self.refine(base, own)
            name, slack = simpler(alone.effect)
            if name == other.place[0]:
                plain, less = self.refine(base, other.candidate)
                if less > found - max(ALIKE, slack * found):
                    alone, found = plain, less
            if found > wanted:
                self.terms = [t for t in self.terms if t is not term and t is not other]
                self.terms.append(self.term(alone))
                return True
        return False
