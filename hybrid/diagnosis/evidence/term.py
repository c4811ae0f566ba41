"""An effect in the model of a gap."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.diagnosis.evidence.candidates import Candidate, Place
from hybrid.diagnosis.evidence.products import Index


@dataclass(frozen=True, eq=False)
class Term:
    """An effect in the model of the gap.

    Attributes:
        candidate: The effect, with its shapes fitted.
        index: Its columns in the evidence.
    """

    candidate: Candidate
    index: Index

    @property
    def place(self) -> Place:
        """Which effect, and where."""
        return self.candidate.place
