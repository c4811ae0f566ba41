"""Causes that may be added to an explanation, with their gain in score."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Index
from hybrid.diagnosis.evidence.candidates import Candidate, Place
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.posterior import Posterior
from hybrid.effects import effect_classes


@dataclass(frozen=True)
class Proposal:
    """A cause that may be added to an explanation.

    Attributes:
        cause: The cause.
        worth: Gain in the score, [nat].
    """

    cause: Cause
    worth: float

    @property
    def place(self) -> Place:
        """Place of the cause."""
        return self.cause.place

    @property
    def candidate(self) -> Candidate | None:
        """The effect with its shapes; ``None`` for an unknown law."""
        return self.cause.candidate


class Proposals(Posterior):
    """A posterior that proposes causes.

    Attributes:
        refused: Places of causes that did not lower the loss on test samples.
        library_only: Whether unknown laws are left out.
    """

    refused: frozenset[Place] = frozenset()
    library_only = False

    def proposals(
        self,
        causes: Sequence[Cause],
        own: Cause | None = None,
    ) -> list[Proposal]:
        """Causes that may be added to some causes, or replace ``own``, best first."""
        whole, rest = self.columns(causes), [c for c in causes if c is not own]
        base, found = self.columns(rest), list[Proposal]()
        less = base[:0] if own is None else own.index
        ranked = self.pool.ranked(whole, self.taken(rest), less)
        there = [k.candidate.effect for k in rest if k.candidate is not None]
        ranked = [
            (c, x) for c, x in ranked
            if c.place not in self.refused
            and not any(c.effect.excludes(k) for k in there)
        ]  # fmt: skip
        rough = {c.place[1][-1]: 0.0 for c, _ in ranked}
        for c, x in ranked:
            k = c.place[1][-1]
            rough[k] = max(rough[k], c.effect.rough**2 * x)
        best = ranked[: self.prior.shortlist]
        short = [c for c, x in best if x > self.prior.refined_share * best[0][1]]
        if own is not None and own.candidate is not None:
            short = [own.candidate, *short]
        now = self.score(rest)
        for c in short:
            cause = self.cause(self.refine(base, c)[0])
            found.append(Proposal(cause, self.score([*rest, cause]) - now))
        laws = [x for x in self.laws.open(rest) if x.place not in self.refused]
        if laws and not self.library_only:
            found.append(self.best_law(laws, rest, whole, less, rough))
        return sorted(found, key=lambda x: -x.worth)

    def best_law(
        self,
        laws: Sequence[Cause],
        rest: Sequence[Cause],
        whole: Index,
        less: Index,
        rough: Mapping[int, float],
    ) -> Proposal:
        """The best of some unknown laws beside other causes.

        Args:
            laws: The laws.
            rest: The other causes.
            whole: Columns of an explanation.
            less: Those of them that the other causes lack.
            rough: Evidence, by joint, that errors of known laws may explain, [nat].
        """
        every = self.laws.all  # the same ones each time, whose screening is kept
        none = [np.full(len(x.index), -np.inf) for x in every]
        gained = self.evidence.screen(whole, [x.index for x in every], none, less=less)
        known = dict(zip(every, gained, strict=True))

        def worth(law: Cause) -> float:
            return float(known[law]) - self.odds(law) - rough.get(law.place[1][0], 0.0)

        best = max(laws, key=worth)
        law = self.laws.widened(self.columns(rest), best)
        gain = self.score([*rest, law]) - self.score(rest)
        return Proposal(law, gain - rough.get(law.place[1][0], 0.0))

    def taken(self, causes: Sequence[Cause]) -> set[Place]:
        """Places of some causes to which no further cause may be added."""
        few = self.prior.most_repeated
        most = {"": 1, "joint": few, "recording": few * len(self.gap.motions)}
        room = {name: most[cls.repeats] for name, cls in effect_classes().items()}
        count = Counter(c.place for c in causes)
        return {place for place, k in count.items() if k >= room.get(place[0], 1)}
