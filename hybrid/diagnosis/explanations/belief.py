"""How probable a cause is."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from hybrid.diagnosis.evidence.candidates import Place
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.proposal import Proposal


@dataclass(frozen=True, eq=False)
class Belief:
    """How probable a cause is, beside all others of an explanation.

    Attributes:
        cause: The cause.
        worth: By how much it raises the score, [nat].
        alike: What may stand in its place, itself first, and how probable each is.
        probability: That it, or a known effect alike, is there; the rest is that of
            no cause or an unknown law.
    """

    cause: Cause
    worth: float
    alike: tuple[tuple[Proposal, float], ...]
    probability: float

    @classmethod
    def of(
        cls,
        cause: Cause,
        worth: float,
        options: Mapping[Place, Proposal],
        twins: Collection[Place],
        least: float,
    ) -> Belief:
        """Normalised over what may stand in its place, and over nothing there.

        Args:
            cause: The cause.
            worth: By how much it raises the score, [nat].
            options: What may stand in its place.
            twins: What has the same torque; only its prior is another.
            least: Probability from which on something counts.
        """
        known = list(options.values())
        nat = np.array([0.0, *(x.worth for x in known)])
        part = np.exp(nat - nat.max())
        part /= part.sum()
        ranked = sorted(zip(known, part[1:], strict=True), key=lambda x: -x[1])
        own = [x for x in ranked if x[0].place == cause.place]
        others = [
            x for x in ranked
            if x[0].place != cause.place and (x[1] >= least or x[0].place in twins)
        ]  # fmt: skip
        likely = sum(p for x, p in ranked if x.candidate is not None)
        return cls(cause, worth, (*own, *others), float(likely))

    def plainest(self, slack: float) -> Proposal | None:
        """A plainer effect that is as probable to within some nat; nothing without."""
        (own, best), *rest = self.alike
        near = [
            x for x, p in rest if x.candidate is not None and p > best * np.exp(-slack)
        ]
        plain = min(near, key=lambda x: x.parameters, default=own)
        return plain if plain.parameters < own.parameters else None
