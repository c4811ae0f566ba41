"""What may be added to an explanation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hybrid.diagnosis.evidence.candidates import Candidate, Place
from hybrid.diagnosis.explanations.cause import Cause


@dataclass(frozen=True)
class Proposal:
    """What may be added to an explanation.

    Attributes:
        place: What it is, and of which joints.
        worth: By how much it raises the score, [nat].
        make: Gives the cause.
        candidate: The effect with its shapes; nothing for an unknown law.
    """

    place: Place
    worth: float
    make: Callable[[], Cause]
    candidate: Candidate | None = None

    @property
    def parameters(self) -> float:
        """How many numbers it has."""
        if self.candidate is None:
            return np.inf
        effect = self.candidate.effect
        return len(effect.gains) + len(effect.shapes)
