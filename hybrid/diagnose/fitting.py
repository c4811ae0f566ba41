"""How terms are fitted to each other: shapes, gains, how far links are off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hybrid.diagnose.candidates import HARDLY, Candidate, fuller, with_gains
from hybrid.diagnose.model import ALIKE, Model, far
from hybrid.diagnose.pool import REPEATED
from hybrid.diagnose.refine import shape_steps
from hybrid.diagnose.shapes import at_places, places
from hybrid.diagnose.term import Term
from hybrid.effects.payload import LinkInertia
from hybrid.robot.chain import Array

_PASSES, _SETTLED = 4, 0.1  # at most; nats that are worth another
_SAME = 0.01  # of the gain that columns are made at: no matter
_FURTHER = (1.0, 3.0, 10.0, 30.0)  # times what a link is off by that is wrong
_KEPT = 0.5  # of the evidence for each other term, whatever a link is off by


class Fitting(Model):
    """How terms that were found are fitted to each other."""

    def fit_together(self) -> None:
        """Fit the shapes of all terms: the best far ones first, then all together."""
        self.scan()
        self.polish()
        self.settle()

    def scan(self) -> None:
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
                self._exchange_for(k, self.pool.at(place), HARDLY)
        return self.terms != before

    def _exchange_for(
        self, k: int, starts: Sequence[Candidate], least: float = 0.0
    ) -> None:
        """Exchange a term for the best of some candidates, refined, if it is better.

        By a part of the evidence for it, at least.
        """
        base = self.base(self.terms[k])
        refined = [self.refine(base, c) for c in starts]
        best = max(refined, key=lambda x: x[1], default=None)
        now = self.loss(self.terms[k])
        if best is not None and best[1] > now + max(ALIKE, least * now):
            self.terms[k] = self.term(best[0])

    def polish(self) -> None:
        """Fit the shapes of all terms together, by Gauss-Newton steps.

        One after the other, on a grid and near it, leaves them short of the optimum.
        """
        for _ in range(_PASSES):
            before, terms = self.worth(), self.terms
            placed = [(t.candidate, t.index) for t in terms]
            steps = shape_steps(self.evidence, self.base(), placed)
            for part in (1.0, 0.3):
                self.terms = [
                    self._moved(t, part * s) if len(s) else t
                    for t, s in zip(terms, steps, strict=True)
                ]
                if self.worth() > before:
                    break
            else:
                self.terms = terms
                return
            if self.worth() < before + _SETTLED:
                return

    def settle(self) -> None:
        """Make the columns of effects on signals at the gains that all terms have."""
        for _ in range(_PASSES):
            gains = self.evidence.solve(self.base())
            moved = [
                k for k, t in enumerate(self.terms)
                if t.candidate.effect.linearised and not t.candidate.effect.shifts
                and far(t.candidate.effect, gains.of(t.index)) > _SAME
            ]  # fmt: skip
            for k in moved:
                c = self.terms[k].candidate
                effect = with_gains(c.effect, gains.of(self.terms[k].index))
                self.terms[k] = self.term(replace(c, effect=effect))
        for k, term in enumerate(self.terms):
            if term.candidate.effect.shifts:
                own, _ = self.refine(self.base(term), term.candidate)
                self.terms[k] = self.term(own)

    def widen(self) -> None:
        """Let a link be further off than most are, where that explains more.

        Not if it would take over what others do, as so many numbers can.
        """
        for k, term in enumerate(self.terms):
            if term.place[0] != LinkInertia.id:
                continue
            rest = [t for t in self.terms if t is not term]
            least, worth = _KEPT * self.losses(rest), []
            for factor in _FURTHER:
                self.evidence.spread(term.index, factor)
                kept = np.all(self.losses(rest) >= least)
                worth.append(self.worth() if kept else -np.inf)
            std = _FURTHER[int(np.argmax(worth))] * term.candidate.std
            self.terms[k] = self.term(replace(term.candidate, std=std))

    def loosen(self) -> None:
        """Exchange a law that does less than its form has to for its free form."""
        solution = self.evidence.solve(self.base())
        for k, term in enumerate(self.terms):
            least = np.maximum(term.candidate.lower, 0.0)
            if np.all(solution.of(term.index)[least > 0] >= least[least > 0]):
                continue
            base, tried = self.base(term), self.pool.at(term.place)
            free = [self.refine(base, c) for c in tried if np.all(c.lower <= 0)]
            if free:
                self.terms[k] = self.term(max(free, key=lambda x: x[1])[0])

    def _moved(self, term: Term, steps: Array) -> Term:
        effect = term.candidate.effect
        effect = at_places(self.gap, effect, places(self.gap, effect) + steps)
        return self.term(replace(term.candidate, effect=effect))
