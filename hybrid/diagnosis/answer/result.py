"""A diagnosis with its intermediate results."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from hybrid.diagnosis.answer.diagnosis import Diagnosis
from hybrid.diagnosis.evidence.candidates import Candidate, Term
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.explanations.search import Search
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect


@dataclass(frozen=True)
class Result:
    """A diagnosis with its intermediate results, for report and export.

    Attributes:
        diagnosis: The diagnosis.
        gap: The gap; a delay that all joints share is part of it.
        search: The search, with the terms of the findings.
        scored: The same terms, scored on held-out samples.
        account: Squares explained and missed at each joint.
        effects: The effects found, with fitted values: those of the terms, then
            :attr:`delays`.
        command: The effects found between command and torque.
        rivals: For each term the candidates that explain as much in its place.
        baseline: Effects of the healthy arm's model, already removed from the logs.
    """

    diagnosis: Diagnosis
    gap: Gap
    search: Search
    scored: Explanation
    account: Account
    effects: tuple[Effect, ...]
    command: tuple[Effect, ...] = ()
    rivals: Mapping[Term, tuple[Candidate, ...]] = field(default_factory=dict)
    baseline: tuple[Effect, ...] = ()

    @property
    def delays(self) -> tuple[Effect, ...]:
        """Delay of torque at every joint, removed from the logs before the search."""
        return self.effects[len(self.scored.terms) :]
