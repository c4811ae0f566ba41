"""Laws of single joints, compiled into one function of plain numbers."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import Law, Tape
from hybrid.effects import Effect, JointEffect, JointState
from hybrid.errors import HybridError
from hybrid.online.layout import Indices, RowLayout

STEP = 1e-4  # relative, for finite differences of the shapes


class InstantLaws:
    """Derivatives of the torque by gains and shapes of many laws at one instant.

    The indices of laws that cannot be compiled, and of effects of more than one joint,
    are in ``others``.
    """

    def __init__(self, effects: Sequence[Effect], layout: RowLayout) -> None:
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
        self.others: list[int] = []
        for e, effect in enumerate(effects):
            try:
                found |= _columns(e, effect, states, layout, tape)
            except (HybridError, TypeError, ValueError):
                self.others.append(e)
        self.places: Indices = np.array(list(found), dtype=int)
        inputs = {x.arguments[0] for x in tape.lines if x.name == "input"}
        marks = [u for u in range(layout.size) if f"theta[{u}]" in inputs]
        self._unknowns = np.array(marks, dtype=int)
        names += [f"theta[{u}]" for u in marks]
        self._law = Law(tape, tuple(found.values()), tuple(names))

    def __call__(
        self, t: float, q: Array, v: Array, a: Array, load: Array, theta: Array
    ) -> Sequence[float]:
        """Derivatives, for the places of a row in ``places``.

        The load is the torque of the rigid body, shape (n,), [N·m], and ``theta`` are
        the unknowns, shape (d,).
        """
        signals = np.concatenate([q, v, a, load, theta[self._unknowns]])
        return self._law.at([t, *signals.tolist()])


def _columns(
    e: int,
    effect: Effect,
    states: Sequence[JointState],
    layout: RowLayout,
    tape: Tape,
) -> dict[int, Any]:
    """Symbolic derivative by each gain and shape, by its place in a row."""
    if not isinstance(effect, JointEffect):
        raise HybridError(f"{effect.id} is no law of one joint's own state")
    (joint,) = effect.joints

    def places(unknowns: Sequence[int]) -> list[int]:
        return [layout.place(joint, u) for u in unknowns]

    def theta(unknown: int) -> Any:
        return tape.input(f"theta[{unknown}]") if unknown >= 0 else 0.0

    gains, slopes = places(layout.gains[e]), places(layout.shapes[e])
    tracked = all(place >= 0 for place in slopes)
    shapes: dict[str, Any] = dict(effect.shape_values)
    if tracked:
        shapes = dict(zip(shapes, map(theta, layout.shapes[e]), strict=True))
    law = [*effect.law(states[joint], **shapes)]

    def torque(law: Sequence[Any]) -> Any:
        return sum(theta(u) * x for u, x in zip(layout.gains[e], law, strict=True))

    found = dict(zip(gains, law, strict=True))
    for name, place in zip(shapes, slopes, strict=True) if tracked else ():
        step = STEP * np.maximum(abs(shapes[name]), STEP)
        moved = effect.law(states[joint], **shapes | {name: shapes[name] + step})
        found[place] = (torque(moved) - torque(law)) / step
    return {place: x for place, x in found.items() if place >= 0}
