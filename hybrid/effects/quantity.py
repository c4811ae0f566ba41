"""Definition of a law's parameters: unit, usual size, bounds and prior."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Scale:
    """Size of one joint, the unit of the usual sizes of effects.

    Attributes:
        torque: Rated torque, [N·m].
        speed: Rated speed, [rad/s].
    """

    torque: float
    speed: float


@dataclass(frozen=True)
class Quantity:
    """Definition of a parameter of a law.

    Attributes:
        name: Standard term of the field.
        unit: SI unit.
        typical: Usual size, in multiples of ``per``.
        lower: Smallest physically plausible value, in multiples of ``per``.
        upper: Largest physically plausible value, in multiples of ``per``.
        per: Powers of the joint's rated torque and speed of which the numbers are
            multiples, e.g. ``(1, -1)`` for torque/speed; ``(0, 0)`` for SI units.
        spread: Prior standard deviation in a fit, in multiples of ``per``; from the
            usual size by default.
        inner: Whether only a fit uses it, and not the law.
        whole: Whether it is chosen instead of fitted, as an integer.
        near: Largest change in one refinement of a fit, in its unit; a share of its
            range by default.
    """

    name: str
    unit: str
    typical: float
    lower: float
    upper: float
    per: tuple[int, int] = (0, 0)
    spread: float | None = None
    inner: bool = False
    whole: bool = False
    near: float | None = None

    @property
    def deviation(self) -> float:
        """Prior standard deviation: twice the usual size, or a third of the largest."""
        if self.spread is not None:
            return self.spread
        largest = max(abs(self.lower), abs(self.upper)) / 3
        return min(2 * abs(self.typical), largest) if self.typical else largest

    def scaled(self, scale: Scale) -> Quantity:
        """The same with numbers in SI units for a joint of this size."""
        size = scale.torque ** self.per[0] * scale.speed ** self.per[1]
        return replace(
            self,
            typical=self.typical * size,
            lower=self.lower * size,
            upper=self.upper * size,
            per=(0, 0),
            spread=None if self.spread is None else self.spread * size,
        )


# The highest speed in the data. Beyond it a law does not run away.
FASTEST = Quantity("fastest", "rad/s", 1e3, 1e-4, 1e3, whole=True)
