"""The most probable explanation of a gap.

Causes are added, exchanged and removed as long as their :class:`.Posterior` rises. Each
step has to lower the squares on folds left out as well, and in the end each cause those
on recordings that the search has not learnt from.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import WIDER
from hybrid.diagnosis.evidence.candidates import Candidate, usual
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.evidence.shapes import price
from hybrid.diagnosis.evidence.term import Term
from hybrid.diagnosis.explanations.belief import Belief, beliefs
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.proposals import Proposals
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.prior import Prior

_ROUNDS = 4  # of adding, exchanging and widening
_FEW = 3  # causes: an arm with more of them may have what most have
_BETTER = 0.5  # nat, for a change to be worth it


class Search(Proposals):
    """Causes of a gap, added, exchanged and removed until nothing is gained.

    Attributes:
        causes: The causes so far.
        beliefs: How probable the known ones are, once it has run.
        whole: All causes, once it has run.
    """

    def __init__(
        self,
        gap: Gap,
        learn: NDArray[np.bool_] | None = None,
        without: Sequence[str] = (),
        prior: Prior | None = None,
    ) -> None:
        super().__init__(gap, learn, without, prior)
        self.causes: list[Cause] = []
        self.beliefs: list[Belief] = []
        self.whole: list[Cause] = []
        self._last: dict[Cause, frozenset[object]] = {}
        self._spreads = list(self.prior.file)  # that are tried

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

    def ranked(self, base: Index) -> list[tuple[Candidate, float]]:
        """See :meth:`.Pool.ranked`."""
        there = [c for c in self.known if c.index[0] in base]
        return self.pool.ranked(base, self.taken(there))

    def loss(self, term: Term) -> float:
        """Evidence that would be lost without a term, [nat]."""
        whole, without = (self.evidence.solve(self.base(t)) for t in (None, term))
        lost = whole.evidence - without.evidence
        return float(lost - price(term.candidate.effect))

    def placed(self, found: Term | Candidate) -> tuple[str, str]:
        """The id of an effect, and the name of the joint that it is at."""
        effect_id, joints = found.place
        return effect_id, self.gap.robot.joints[joints[-1]]

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
        self.causes, self.refused = self._with_usual([]), frozenset()
        self._widen()
        self.listen(self.causes)
        self._remove()
        for self.library_only in (True, False):
            self._settle()
        now = self.score(self.causes) - self.doubt(self.off)
        self.evidence.spread(self.numbers, before[1])
        if self.score(before[0]) - self.doubt(before[1]) > now:
            self.causes = before[0]
            self.spread(before[1])
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
            self._narrow()  # some causes may have been taken back
            return
        self.causes, self.library_only = self.known, True
        self.refused = frozenset()
        usual = self._with_usual(self.causes)
        self.causes = max(self.causes, usual, key=self.score)
        self._remove()
        self._settle()

    def _settle(self) -> None:
        """Grow an explanation until all of its causes hold on unseen recordings."""
        while True:
            self._grow()
            bad = [c for c, fall in self.unseen(self.causes).items() if fall <= 0]
            if not (bad or self._narrow() or self.listen(self.causes)):
                break
            self.refused |= {c.place for c in bad}
            self.causes = [c for c in self.causes if c not in bad]

    def _grow(self) -> None:
        for _ in range(_ROUNDS):
            changed = False
            while self._add():
                changed = True
            for cause in list(self.causes):
                if cause in self.causes and self._last.get(cause) != self._near(cause):
                    if self._renew(cause):
                        changed = True
                    else:
                        self._last[cause] = self._near(cause)
            if not changed and not self._widen():
                break

    def _near(self, cause: Cause) -> frozenset[object]:
        """What is at the same joints; what is at others hardly matters to a cause."""
        own = set(cause.place[1])
        near = (c for c in self.causes if own.intersection(c.place[1]))
        return frozenset([self.library_only, self.off, self.noise.tobytes(), *near])

    def _widen(self) -> bool:
        """Let the file's numbers be as far off as is most probable."""

        def score(off: float) -> float:
            self.evidence.spread(self.numbers, off)
            return self.score(self.causes) - self.doubt(off)

        def lost(off: float) -> Array:
            self.evidence.spread(self.numbers, off)
            return self.left_out(self.causes)

        now, best = self.off, max(self._spreads, key=score)
        wider = score(best) > score(now) + _BETTER
        wider = wider and bool(np.all(lost(best) < lost(now)))
        self.evidence.spread(self.numbers, now)
        if wider:
            self.spread(best)
        return wider

    def _narrow(self) -> bool:
        """Take the file's numbers to be off as usual if more fails on unseen samples.

        Returns:
            Whether more had failed; it is not tried again then.
        """
        usual, now = self.prior.file[1], self.off
        if now <= usual:
            return False
        whole = self.lost(self.causes)
        self.evidence.spread(self.numbers, usual)
        holds = np.min(self.lost(self.causes) - whole) > 0
        self.evidence.spread(self.numbers, now)
        if not holds:
            self._spreads = [x for x in self._spreads if x <= usual]
            self.spread(usual)
        return not holds

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
        now, then = map(self.left_out, (self.causes, causes))
        return bool(np.all(then < now))

    def _remove(self) -> None:
        """Take out causes that are worth less than their odds."""
        while self.causes:
            now = self.score(self.causes)
            rest = [[x for x in self.causes if x is not c] for c in self.causes]
            pairs = zip(self.causes, rest, strict=True)
            worth = now - np.array([self.score(x) for x in rest])
            spare = worth - np.array([self._left_out(x, c) for c, x in pairs])
            weakest = int(np.argmin(spare))
            if spare[weakest] >= 0.0:
                return
            self.causes = rest[weakest]

    def _left_out(self, causes: Sequence[Cause], other: Cause) -> float:
        """What rough laws leave out, which another cause may be no more than, [nat].

        A rough law of the library is more than what an unknown one leaves out.
        """
        known = other.candidate is not None
        least = [other.rough if known and not c.candidate else 0.0 for c in causes]
        rough = [c for c, x in zip(causes, least, strict=True) if c.rough > x]
        if not rough:
            return 0.0
        whole = self.score(causes)
        less = [self.score([x for x in causes if x is not c]) for c in rough]
        pairs = zip(rough, less, strict=True)
        return max(c.rough**2 * (whole - x) for c, x in pairs)

    def _renew(self, cause: Cause) -> bool:
        """Exchange a cause for whatever explains most in its place, or for nothing."""
        now = self.score(self.causes)
        rest = [c for c in self.causes if c is not cause]
        alone = self.score(rest)
        for found in self.proposals(self.causes, own=cause)[:2]:
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
                law = self.unknown(laws, base, base, base[:0], {})
                self.causes.append(law.make())
            self._remove()
        return bool(masks)
