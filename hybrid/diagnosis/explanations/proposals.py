"""What may be added to an explanation, and how much more probable it makes it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from functools import partial
from weakref import proxy

import numpy as np

from hybrid.diagnosis.evidence.candidates import Place
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.posterior import Posterior
from hybrid.diagnosis.explanations.proposal import Proposal
from hybrid.effects import effect_classes


class Proposals(Posterior):
    """What may be added to any causes of a gap.

    Attributes:
        refused: Places of causes that did not hold on unseen recordings.
        library_only: Whether unknown laws are left out.
    """

    refused: frozenset[Place] = frozenset()
    library_only = False

    def proposals(
        self, causes: Sequence[Cause], own: Cause | None = None
    ) -> list[Proposal]:
        """What may be added to some causes, and by how much it raises the score.

        Args:
            causes: The causes.
            own: One of them, in whose place it is to be; its shapes are fitted anew.
        """
        whole, rest = self.columns(causes), [c for c in causes if c is not own]
        base, found = self.columns(rest), list[Proposal]()
        less = base[:0] if own is None else own.index
        ranked = self.pool.ranked(whole, self.taken(rest), less)
        ranked = [(c, x) for c, x in ranked if c.place not in self.refused]
        rough = {c.place[1][-1]: 0.0 for c, _ in ranked}
        for c, x in ranked:
            k = c.place[1][-1]
            rough[k] = max(rough[k], c.effect.rough**2 * x)
        ranked = ranked[: self.prior.shortlist]
        short = [c for c, x in ranked if x > self.prior.refined * ranked[0][1]]
        if own is not None and own.candidate is not None:
            short = [own.candidate, *short]
        for c in short:
            better, worth = self.refine(base, c)
            make = partial(Proposals.cause, proxy(self), better)  # a search keeps these
            alike = self.alike(rest, c.place[0]) - self.alike(rest)
            odds = self.prior.cause - alike + self.mimicked(c)
            found.append(Proposal(c.place, worth - odds, make, better))
        laws = [x for x in self.laws.open(rest) if x.place not in self.refused]
        if laws and not self.library_only:
            found.append(self.unknown(laws, base, whole, less, rough))
        return sorted(found, key=lambda x: -x.worth)

    def unknown(
        self,
        laws: Sequence[Cause],
        base: Index,
        whole: Index,
        less: Index,
        rough: Mapping[int, float],
    ) -> Proposal:
        """The best of some unknown laws beside a base, which is a whole less a part.

        What a rough law of the library leaves out at a joint is no unknown law.
        """
        every = self.laws.all  # the same ones each time, whose products are kept
        none = [np.full(len(x.index), -np.inf) for x in every]
        gained = self.evidence.screen(whole, [x.index for x in every], none, less=less)
        known = dict(zip(every, gained, strict=True))
        worth = {
            x: float(known[x]) - self.odds(x) - rough.get(x.place[1][0], 0.0)
            for x in laws
        }
        law = max(laws, key=worth.__getitem__)
        make = partial(self.laws.widened, base, law)
        return Proposal(law.place, worth[law], make)

    def taken(self, causes: Sequence[Cause]) -> set[Place]:
        """Where no more may be than some causes: one of a kind, or a few."""
        most = self.prior.repeated
        count = Counter(c.place for c in causes)
        again = {x.id for x in effect_classes().values() if x.repeats}
        return {x for x, k in count.items() if k >= (most if x[0] in again else 1)}
