"""The gap as what the file is a little off by, and the effects taken to be there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.background import background
from hybrid.diagnose.candidates import (
    Candidate,
    Place,
    prompt,
    simpler,
    undeclared,
    with_gains,
)
from hybrid.diagnose.contacts import at_once, witnessed
from hybrid.diagnose.evidence import Evidence
from hybrid.diagnose.gap import Gap
from hybrid.diagnose.pool import Pool
from hybrid.diagnose.products import Index
from hybrid.diagnose.refine import refine
from hybrid.diagnose.shapes import price
from hybrid.diagnose.term import Term
from hybrid.effects import Effect
from hybrid.effects.contact import Contact
from hybrid.robot import Robot
from hybrid.robot.chain import Array

WORTH = 10.0  # nats that a term must add
ALIKE = 3.0  # nats that do not settle which of two effects it is
# Sizes of the background that are tried: one standard deviation, relative.
OFF = (0.003, 0.01, 0.03)
WIDEST = OFF[-1]

_RIPPLES = 9  # orders tried at each joint at first
_SHORTLIST = 4
_MENDING = 0.015  # of the evidence for the largest term at a joint
MENDING_ROUGH = 0.2  # if the law of that one holds roughly, and in time at that
_FAR = 0.5  # of the gain that columns are made at


class Model:
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
        self.gone: set[Place] = set()  # came, and did not stay
        self.assume(WIDEST)
        self.pool.take_ripples(self.background, _RIPPLES)
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        # In units of noise; without them it would hold them.
        most = self.evidence.noise.copy()
        self.pool.take_contacts(self.background, sure=False)
        self.evidence.estimate_noise(np.arange(self.evidence.size))
        self.evidence.noise = np.minimum(most, self.evidence.noise)
        # Where the file's numbers may be far off, these would seem to be the cause.
        with self.assuming(OFF[0]):
            self.pool.take_steep(self.background)

    def assume(self, off: float) -> None:
        """Let numbers of the file be off by about so much of themselves."""
        self.off = off
        self.evidence.spread(self.background, off)

    @contextmanager
    def assuming(self, off: float) -> Iterator[None]:
        """The same for a while."""
        usual = self.off
        self.assume(off)
        try:
            yield
        finally:
            self.assume(usual)

    def having(self, chosen: Sequence[Candidate]) -> Self:
        """The same with other terms, of shapes as they are."""
        other = copy(self)
        other.terms = [self.term(c) for c in chosen]
        return other

    def base(self, without: Term | None = None) -> Index:
        """Columns of the background and of all terms, or all but one."""
        parts = [t.index for t in self.terms if t is not without]
        return np.concatenate([self.background, *parts])

    def term(self, c: Candidate) -> Term:
        """A candidate as a term, with columns of its own."""
        (index,) = self.evidence.add([self.gap.columns(c.effect)], [c.std])
        return Term(c, index)

    def placed(self, found: Term | Candidate) -> tuple[str, str]:
        """The id of an effect, and the name of the joint that it is at."""
        effect_id, joints = found.place
        return effect_id, self.gap.robot.joints[joints[-1]]

    def loss(self, term: Term) -> float:
        """Evidence that would be lost without a term, [nat]."""
        return float(self.losses([term])[0])

    def losses(self, terms: Sequence[Term] | None = None) -> Array:
        """The same of some terms, each alone, shape (m,); of all by default."""
        chosen, worth = self.terms if terms is None else terms, self.worth()
        rest = [self.evidence.solve(self.base(t)).evidence for t in chosen]
        return worth - np.array(rest) - [price(t.candidate.effect) for t in chosen]

    def worth(self) -> float:
        """Evidence for all terms together, [nat]."""
        return self.evidence.solve(self.base()).evidence

    def total(self) -> float:
        """The same less what each term must add, and its shapes cost, [nat]."""
        prices = sum(WORTH + price(t.candidate.effect) for t in self.terms)
        return self.worth() - prices

    def ranked(self, base: Index) -> list[tuple[Candidate, float]]:
        """See :meth:`.Pool.ranked`."""
        taken = {t.place for t in self.terms if t.index[0] in base}
        ranked = self.pool.ranked(base, taken)
        return [x for x in ranked if x[0].place not in self.gone]

    def best(
        self, base: Index, at: tuple[int, ...] = ()
    ) -> tuple[Candidate, float] | None:
        """The candidate that adds most evidence, with its shapes fitted.

        A law gives way to the simpler one that it becomes at a bound of its shapes, and
        to one that explains the sign of its gain better; a link that would be another
        one altogether, and what happens once, to whatever explains half as much.
        """
        refined: list[tuple[Candidate, float]] = []
        top = WORTH
        for c, first in self.ranked(base):
            if at and c.place[1] != at:
                continue
            if first <= 0.5 * top or len(refined) == _SHORTLIST:
                break
            found = self.refine(base, c)
            if self.holds(found[0]):
                top = top if refined else first
                refined.append(found)
        if not refined:
            return None
        refined = [x for x in refined if self._likely(base, x[0])] or refined
        half = 0.5 * max(x for _, x in refined)
        lasting = [x for x in refined if x[0].place[0] != Contact.id and x[1] > half]
        best, most = max(lasting or refined, key=lambda x: x[1])
        name, slack = simpler(best.effect)
        near = [
            x for x in refined
            if x[0].place == (name, best.effect.joints)
            and x[1] > most - max(ALIKE, slack * most)
        ]  # fmt: skip
        return near[0] if near else (best, most)

    def holds(self, c: Candidate) -> bool:
        """Whether every motion bears a candidate out, and one shows it come."""
        borne_out = all(c.effect.holds(motion) for motion in self.gap.motions)
        return borne_out and witnessed(self.gap, c.effect)

    def _likely(self, base: Index, c: Candidate) -> bool:
        columns = self.gap.columns(c.effect)
        return c.likely(self.evidence.trial(base, columns, c.std, c.lower)[1])

    def refine(self, base: Index, c: Candidate) -> tuple[Candidate, float]:
        """See :func:`.refine.refine`."""
        return refine(self.evidence, base, c)

    def renew(self, term: Term) -> bool:
        """Fit a term anew beside the others; whether that made much of a difference."""
        base = self.base(term)
        own, now = self.refine(base, term.candidate)
        best = self.best(base)
        if best is not None and best[1] > now + ALIKE:
            own, now = best
        before = self.loss(term) if self._holds_gain(term) else -np.inf
        if now <= before + 0.5:
            return False
        self.terms[self.terms.index(term)] = self.term(own)
        return own.place != term.place or now > before + ALIKE

    def _holds_gain(self, term: Term) -> bool:
        """Whether a term's gains are near those that its columns are made at.

        Those of an effect on signals are not linear: far off they are another law's.
        """
        effect = term.candidate.effect
        if not effect.linearised:
            return True
        gains = self.evidence.solve(self.base()).of(term.index)
        return far(effect, gains) <= _FAR

    def remove(self) -> None:
        """Take out terms that add little, the weakest first."""
        robot = self.gap.robot
        while self.terms:
            losses = self.losses()
            sizes = [self.size(t, x) for t, x in zip(self.terms, losses, strict=True)]
            large = list(zip(self.terms, sizes, self.parts(), strict=True))
            # Beside a large one at the same joint, a small term mends an inexact law.
            at = [list(t.candidate.effect.reaches(robot.size)) for t in self.terms]
            least = [
                max(_mending(robot, t, o) * x * part[j].sum() for o, x, part in large
                    if o.place[1][-1] == t.place[1][-1] or t.place[0] == Contact.id)
                for t, j in zip(self.terms, at, strict=True)
            ]  # fmt: skip
            wanted = np.where(self.idle(), np.inf, np.maximum(least, WORTH))
            margin = losses - wanted
            weakest = int(np.argmin(margin))
            if margin[weakest] >= 0:
                return
            del self.terms[weakest]

    def size(self, term: Term, loss: float) -> float:
        """Evidence that would be lost without a term, or all contacts at its time.

        One that is repeated hardly differently is worth little beside its likes.

        Args:
            term: The term.
            loss: Evidence that would be lost without it, [nat].
        """
        own = term.candidate.effect
        rest = [t for t in self.terms if not at_once(own, t.candidate.effect)]
        if len(rest) >= len(self.terms) - 1:
            return loss
        base = np.concatenate([self.background, *(t.index for t in rest)])
        return self.worth() - self.evidence.solve(base).evidence

    def idle(self) -> list[bool]:
        """Whether each term is late by no more than any sampled drive."""
        gains = self.evidence.solve(self.base())
        effects = [
            with_gains(t.candidate.effect, gains.of(t.index)) for t in self.terms
        ]
        return [prompt(e) for e in effects]

    def parts(self) -> list[Array]:
        """How what each term makes is parted among the joints, shape (n,) each."""
        solution = self.evidence.solve(self.base())
        made = [self.evidence.made(t.index, solution.of(t.index)) for t in self.terms]
        return [x / max(x.sum(), 1e-300) for x in made]


def _mending(robot: Robot, small: Term, large: Term) -> float:
    """Part of a term's evidence that another one needs, not to mend its law.

    Play and springs are right but for when a link lands or swings: a delay makes up, as
    it does for a lag that is not quite one. Nothing is needed beside what every drive
    has and the file lacks, nor of it.
    """
    effect, other = small.candidate.effect, large.candidate.effect
    if undeclared(robot, effect) or undeclared(robot, other):
        return 0.0
    late = effect.differentiates and other.differentiates
    rough = late or (effect.linearised and other.steep)
    return MENDING_ROUGH if rough else _MENDING


def far(effect: Effect, gains: Array) -> float:
    """How far some gains are from those of an effect, if any, relative."""
    made = effect.gain_values
    if not made.any():
        return 0.0
    return float(np.linalg.norm(gains - made) / np.linalg.norm(made))
