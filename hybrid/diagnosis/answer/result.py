"""A diagnosis with what it was made from."""

from __future__ import annotations

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
    """A diagnosis with what it was made from, for report and export.

    Attributes:
        diagnosis: The answer.
        gap: The gap, with the log taken at its word where torque in it is late.
        search: The search, with the terms that may be named.
        scored: The same terms on samples that no step has seen.
        account: What is explained and missed, joint by joint.
        effects: The effects named, with fitted values: those of the terms, then
            :attr:`late`.
        command: Those between command and torque.
        alike: Terms that are believed, and what explains as much in their place.
        healthy: Effects of the model that was the simulator, taken from the logs.
    """

    diagnosis: Diagnosis
    gap: Gap
    search: Search
    scored: Explanation
    account: Account
    effects: tuple[Effect, ...]
    command: tuple[Effect, ...] = ()
    alike: Mapping[Term, tuple[Candidate, ...]] = field(default_factory=dict)
    healthy: tuple[Effect, ...] = ()

    @property
    def late(self) -> tuple[Effect, ...]:
        """By how much torque was late at every joint, taken back before the search."""
        return self.effects[len(self.scored.terms) :]
