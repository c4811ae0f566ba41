"""Parameters of a law without values yet, scaled to the size of a joint."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Scale:
    """Size of one joint, in which the usual sizes of effects are stated.

    Attributes:
        torque: Rated torque, [N·m].
        speed: Rated speed, [rad/s].
    """

    torque: float
    speed: float


@dataclass(frozen=True)
class Quantity:
    """A parameter of a law before it has a value.

    Attributes:
        name: Field's standard term.
        unit: SI unit.
        typical: Usual size, in multiples of ``per``.
        lower: Smallest physically plausible value, in multiples of ``per``.
        upper: Largest physically plausible value, in multiples of ``per``.
        per: What the numbers are multiples of: powers of the joint's rated torque and
            speed, e.g. ``(1, -1)`` for torque/speed; ``(0, 0)`` for plain SI.
        spread: Prior standard deviation in a fit, in multiples of ``per``; from its
            usual size if not given.
        inner: Whether it is of the fit alone, and no law has it.
        whole: Whether it is a number of something, which is chosen and not fitted.
        near: How far from a value a fit may look, in its unit; a part of its range if
            not given.
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
