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
    """A diagnosis with its intermediate results, for report and export."""

    diagnosis: Diagnosis
    gap: Gap  # the gap; a delay that all joints share is part of it
    search: Search  # the search, with the terms of the findings
    scored: Explanation  # the same terms, scored on held-out samples
    account: Account  # squares explained and missed at each joint
    # The effects found, with fitted values: those of the terms, then :attr:`delays`.
    effects: tuple[Effect, ...]
    command: tuple[Effect, ...] = ()  # the effects found between command and torque
    # For each term the candidates that explain as much in its place.
    rivals: Mapping[Term, tuple[Candidate, ...]] = field(default_factory=dict)
    # Effects of the healthy arm's model, already removed from the logs.
    baseline: tuple[Effect, ...] = ()

    @property
    def delays(self) -> tuple[Effect, ...]:
        """Delay of torque at every joint, removed from the logs before the search."""
        return self.effects[len(self.scored.terms) :]
