"""The probability of a cause, and of the alternatives to it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hybrid.diagnosis.evidence.candidates import Candidate, Place, scale_of
from hybrid.diagnosis.evidence.refine import gain
from hybrid.diagnosis.explanations.cause import Cause
from hybrid.diagnosis.explanations.moves import LEAST_GAIN
from hybrid.diagnosis.explanations.proposals import Proposal

if TYPE_CHECKING:
    from hybrid.diagnosis.explanations.search import Search


@dataclass(frozen=True, eq=False)
class Belief:
    """Probability of a cause, beside all others of an explanation.

    Attributes:
        cause: The cause.
        worth: Gain in the score by it, [nat].
        alternatives: Proposals in its place with their probabilities, itself first.
        probability: Probability that a known effect is in its place. The rest is that
            of no cause, or of an unknown law.
        limit: Id of the law that it has become, at the limit of its own; see
            :attr:`.Effect.becomes`.
        equals: Effects in its place under which the recordings are as probable: only
            priors tell these from it.
    """

    cause: Cause
    worth: float
    alternatives: tuple[tuple[Proposal, float], ...]
    probability: float
    limit: str | None = None
    equals: tuple[Candidate, ...] = ()

    @classmethod
    def of(
        cls,
        cause: Cause,
        worth: float,
        options: Mapping[Place, Proposal],
        share: float,
        limit: str | None = None,
    ) -> Belief:
        """Normalise the probabilities of the options in place of a cause, and of none.

        The alternatives are the smallest set that holds a share of the probability. The
        law that a cause has become has the same torque, and is one of them anyhow.
        """
        known = list(options.values())
        nat = np.array([0.0, *(x.worth for x in known)])
        part = np.exp(nat - nat.max())
        part /= part.sum()
        ranked = sorted(zip(known, part[1:], strict=True), key=lambda x: -x[1])
        own = [x for x in ranked if x[0].place == cause.place]
        become = limit, cause.place[1]
        before = np.cumsum([0.0, *(p for _, p in ranked)]) / max(part[1:].sum(), 1e-300)
        others = [
            x for x, held in zip(ranked, before, strict=False)
            if x[0].place != cause.place and (held < share or x[0].place == become)
        ]  # fmt: skip
        likely = sum(p for x, p in ranked if x.candidate is not None)
        return cls(cause, worth, (*own, *others), float(likely), limit)

    @property
    def become(self) -> Cause | None:
        """The law at its joints that it has become, if that is an alternative."""
        place = self.limit, self.cause.place[1]
        return next((x.cause for x, _ in self.alternatives if x.place == place), None)


def beliefs(search: Search) -> list[Belief]:
    """The probability of each known cause of a search, and its alternatives."""
    now, found = search.score(search.causes), []
    for cause in search.known:
        rest = [c for c in search.causes if c is not cause]
        worth = now - search.score(rest)
        options: dict[Place, Proposal] = {}
        for x in search.proposals(search.causes, own=cause):
            if not _independent(search, cause, x):
                worse = _foretells_worse(search, rest, x, worth)
                options.setdefault(x.place, replace(x, worth=worth) if worse else x)
        limit, share = _limit(search, cause, rest), search.prior.in_class
        belief = Belief.of(cause, worth, options, share, limit)
        equals = _equals(cause, worth, options.values(), share)
        found.append(replace(belief, equals=equals))
    return found


def _equals(
    cause: Cause, worth: float, options: Iterable[Proposal], share: float
) -> tuple[Candidate, ...]:
    """Candidates of some options under which the recordings are as probable."""
    least = worth + cause.cost + np.log(1.0 - share)
    return tuple(
        x.candidate for x in options
        if x.candidate is not None
        and x.place != cause.place
        and x.worth + x.cause.cost > least
    )  # fmt: skip


def _independent(search: Search, cause: Cause, other: Proposal) -> bool:
    """Whether a proposal at other joints raises the score beside a cause."""
    if other.worth <= 0.0 or {*cause.place[1]} & {*other.place[1]}:
        return False
    both = search.score([*search.causes, other.cause])
    return both > search.score(search.causes)


def _foretells_worse(
    search: Search, rest: list[Cause], other: Proposal, worth: float
) -> bool:
    """Whether a known effect scores more than a cause, but foretells folds worse.

    The search has not taken it then: it is as probable as the cause, and no more.
    """
    better = other.candidate is not None and other.worth > worth + LEAST_GAIN
    return better and not search.is_cross_validated([*rest, other.cause])


def _limit(search: Search, cause: Cause, rest: list[Cause]) -> str | None:
    """Id of the law that a cause has become, if a shape is at an end of its range.

    It has if it is better than at that end by no more than errors of laws.
    """
    c = cause.candidate
    end = None if c is None else c.effect.at_limit(scale_of(search.gap, c.effect))
    if c is None or end is None:
        return None
    base = search.columns(rest)
    own, there = (gain(search.evidence, base, c.at(x)) for x in (c.effect, end[0]))
    return end[1] if own - there < search.model_error_odds(cause) else None


def is_known(search: Search, cause: Cause) -> bool:
    """Whether known causes are worth more than unknown laws, where a cause acts most.

    That is the joint with most of its torque. All known causes there count together:
    each alone is worth little if the others can take its place.
    """
    evidence, causes = search.evidence, search.causes
    solution = evidence.solve(search.columns(causes))

    def joint(c: Cause) -> int:
        squares = evidence.fitted_squares(c.index, solution.of(c.index))
        return int(np.argmax(squares))

    at = joint(cause)
    known = [c for c in causes if c.candidate is not None and joint(c) == at]
    unknown = [c for c in causes if c.candidate is None and c.place[1] == (at,)]
    without_known, without_unknown = (
        search.score([c for c in causes if c not in lost]) for lost in (known, unknown)
    )
    return without_known < without_unknown
