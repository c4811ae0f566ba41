"""A cause in an explanation: an effect of the library, or a law that it lacks."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.diagnosis.evidence.candidates import Candidate, Place
from hybrid.diagnosis.evidence.products import Index


@dataclass(frozen=True, eq=False)
class Cause:
    """One part of an explanation.

    Attributes:
        place: Id of the effect, or what an unknown law is of; and the joints.
        index: Its columns in the evidence.
        cost: Odds against it before any recording, and for the choice of its shapes,
            [nat].
        candidate: The effect with its shapes; nothing for an unknown law.
        rough: Part of its torque's RMS that its law leaves out.
    """

    place: Place
    index: Index
    cost: float
    candidate: Candidate | None = None
    rough: float = 0.0
