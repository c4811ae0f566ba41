"""How probable a cause is."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybrid.diagnosis.evidence.candidates import Place, same, scale_of
from hybrid.diagnosis.evidence.refine import gain
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.proposal import Proposal

if TYPE_CHECKING:
    from hybrid.diagnosis.explanations.search import Search


@dataclass(frozen=True, eq=False)
class Belief:
    """How probable a cause is, beside all others of an explanation.

    Attributes:
        cause: The cause.
        worth: By how much it raises the score, [nat].
        alike: What may stand in its place, itself first, and how probable each is.
        probability: That it, or a known effect alike, is there; the rest is that of
            no cause or an unknown law.
        limit: Id of what it cannot be told from, where it is not itself any more; see
            :attr:`.Effect.becomes`.
    """

    cause: Cause
    worth: float
    alike: tuple[tuple[Proposal, float], ...]
    probability: float
    limit: str | None = None

    @classmethod
    def of(
        cls,
        cause: Cause,
        worth: float,
        options: Mapping[Place, Proposal],
        twins: Collection[Place],
        least: float,
        limit: str | None = None,
    ) -> Belief:
        """Normalised over what may stand in its place, and over nothing there.

        Args:
            cause: The cause.
            worth: By how much it raises the score, [nat].
            options: What may stand in its place.
            twins: What has the same torque; only its prior is another.
            least: Probability from which on something counts.
            limit: Id of what it cannot be told from, if it is at its limit.
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
        return cls(cause, worth, (*own, *others), float(likely), limit)

    def plainest(self, slack: float) -> Proposal | None:
        """A plainer effect that is as probable to within some nat; nothing without.

        A law at a limit, where it is another one, is that one.
        """
        (own, best), *rest = self.alike
        known = [(x, p) for x, p in rest if x.candidate is not None]
        for x, _ in known:
            if x.place == (self.limit, own.place[1]):
                return x
        near = [x for x, p in known if p > best * np.exp(-slack)]
        plain = min(near, key=lambda x: x.parameters, default=own)
        return plain if plain.parameters < own.parameters else None


def beliefs(search: Search) -> list[Belief]:
    """How probable each known cause is, and what might stand in its place."""
    now, found = search.score(search.causes), []
    for cause in search.known:
        rest = [c for c in search.causes if c is not cause]
        worth = now - search.score(rest)
        options: dict[Place, Proposal] = {}
        for x in search.proposals(search.causes, own=cause):
            options.setdefault(x.place, x)
        twins = {place for place, x in options.items() if _twin(search, cause, x)}
        limit, least = _limit(search, cause, rest), search.prior.alike
        found.append(Belief.of(cause, worth, options, twins, least, limit))
    return found


def _twin(search: Search, cause: Cause, other: Proposal) -> bool:
    """Whether something else has the same torque, and but another prior."""
    one, two = cause.candidate, other.candidate
    if one is None or two is None or one.place[1] != two.place[1]:
        return False
    return same(*(search.gap.columns(c.effect) for c in (one, two)))


def _limit(search: Search, cause: Cause, rest: list[Cause]) -> str | None:
    """Id of what it cannot be told from, at an end of a shape, or nothing.

    What it is worth more may be no more than laws are inexact by.
    """
    c = cause.candidate
    end = None if c is None else c.effect.at_limit(scale_of(search.gap, c.effect))
    if c is None or end is None:
        return None
    base = search.columns(rest)
    own, there = (
        gain(search.evidence, base, replace(c, effect=x)) for x in (c.effect, end[0])
    )
    return end[1] if own - there < search.mimicked(cause) else None


def unknown_worth(search: Search, cause: Cause) -> float:
    """What the unknown laws are worth at the joint that a cause is about, [nat]."""
    evidence, causes = search.evidence, search.causes
    gains = evidence.solve(search.columns(causes)).of(cause.index)
    order = np.argsort(cause.index)
    joint = int(np.argmax(evidence.made(cause.index[order], gains[order])))
    rest = [c for c in causes if c.candidate is not None or c.place[1] != (joint,)]
    return search.score(causes) - search.score(rest)
