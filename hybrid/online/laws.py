"""Laws of joints' own states, written down as one function of numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import Law, Tape
from hybrid.effects import Effect, JointEffect, JointState
from hybrid.errors import HybridError
from hybrid.online.layout import Indices, RowLayout

STEP = 1e-4  # relative, for slopes of the shapes


@dataclass(frozen=True)
class Numbered:
    """An effect and its unknowns.

    Attributes:
        effect: The effect; its shapes are as at first.
        gains: Unknown of each gain; −1 if it is not tracked.
        shapes: Unknown of each shape.
    """

    effect: Effect
    gains: list[int]
    shapes: list[int]


class InstantLaws:
    """Columns of the gains, and slopes of the shapes, of many laws at one instant.

    Laws that cannot be written down as operations on numbers, and effects that are no
    law of one joint's own state, are left in ``others``.

    Args:
        effects: Effects with their unknowns.
        layout: Where their columns stand in a row.
    """

    def __init__(self, effects: Sequence[Numbered], layout: RowLayout) -> None:
        n, tape = layout.joint_count, Tape()
        names = ["t", *(f"{x}[{j}]" for x in ("q", "v", "a", "load") for j in range(n))]
        t, *signals = (tape.input(name) for name in names)
        states = [
            JointState(t, q, v, a, np.sign(v), load)
            for q, v, a, load in zip(
                *(signals[k * n : k * n + n] for k in range(4)), strict=True
            )
        ]
        found: dict[int, Any] = {}
        self.others: list[Numbered] = []
        for own in effects:
            try:
                found |= _columns(own, states, layout, tape)
            except (HybridError, TypeError, ValueError):
                self.others.append(own)
        self.places: Indices = np.array(list(found), dtype=int)
        inputs = {x.arguments[0] for x in tape.lines if x.name == "input"}
        marks = [u for u in range(layout.size) if f"theta[{u}]" in inputs]
        self._unknowns = np.array(marks, dtype=int)
        names += [f"theta[{u}]" for u in marks]
        self._law = Law(tape, tuple(found.values()), tuple(names))

    def __call__(
        self, t: float, q: Array, v: Array, a: Array, load: Array, theta: Array
    ) -> Sequence[float]:
        """Values of the places in ``places``.

        Args:
            t: Time, [s].
            q: Position, shape (n,), [rad].
            v: Speed, shape (n,), [rad/s].
            a: Acceleration, shape (n,), [rad/s²].
            load: Torque of the rigid body, shape (n,), [N·m].
            theta: Unknowns, shape (d,).
        """
        signals = np.concatenate([q, v, a, load, theta[self._unknowns]])
        return self._law.at([t, *signals.tolist()])


def _columns(
    own: Numbered, states: Sequence[JointState], layout: RowLayout, tape: Tape
) -> dict[int, Any]:
    """Place -> column of a gain or slope of a shape, as symbols."""
    effect = own.effect
    if not isinstance(effect, JointEffect):
        raise HybridError(f"{effect.id} is no law of one joint's own state")
    (joint,) = effect.joints

    def places(unknowns: Sequence[int]) -> list[int]:
        return [layout.place(joint, u) for u in unknowns]

    def theta(unknown: int) -> Any:
        return tape.input(f"theta[{unknown}]") if unknown >= 0 else 0.0

    gains, slopes = places(own.gains), places(own.shapes)
    tracked = all(place >= 0 for place in slopes)
    shapes: dict[str, Any] = dict(effect.shape_values)
    if tracked:
        shapes = dict(zip(shapes, map(theta, own.shapes), strict=True))
    law = [*effect.law(states[joint], **shapes)]

    def torque(law: Sequence[Any]) -> Any:
        return sum(theta(u) * x for u, x in zip(own.gains, law, strict=True))

    found = dict(zip(gains, law, strict=True))
    for name, place in zip(shapes, slopes, strict=True) if tracked else ():
        step = STEP * np.maximum(abs(shapes[name]), STEP)
        moved = effect.law(states[joint], **shapes | {name: shapes[name] + step})
        found[place] = (torque(moved) - torque(law)) / step
    return {place: x for place, x in found.items() if place >= 0}
