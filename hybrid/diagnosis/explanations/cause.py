"""A cause in an explanation: an effect of the library, or an unknown law."""

from dataclasses import dataclass

from hybrid.arrays import Index
from hybrid.diagnosis.evidence.candidates import Candidate, Place


@dataclass(frozen=True, eq=False)
class Cause:
    """One part of an explanation.

    Attributes:
        place: Id of the effect, or name of the unknown law; and the joints.
        index: Its columns in the evidence.
        cost: Log odds against it, with the price of its shapes, [nat].
        candidate: The effect with its shapes; ``None`` for an unknown law.
        rough: RMS error of its law, relative to its torque.
    """

    place: Place
    index: Index
    cost: float
    candidate: Candidate | None = None
    rough: float = 0.0

    @property
    def is_event(self) -> bool:
        """Whether it happens at a time, and not by a law."""
        known = self.candidate
        return known is not None and known.effect.repeats == "recording"
