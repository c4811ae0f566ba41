"""What the arm of ``three_stage_coman.py`` has and no effect of the library describes.

A hose that runs loosely past two joints, and grease that the joint has pushed aside
where it works most. Both are of the plant only: no fit is offered them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointEffect, JointState, Port, Quantity, Scale
from hybrid.signals import Motion

# Share of the rated torque: of a hose that both joints stretch, of thick grease.
HOSE, GREASE = 0.015, 0.015
_SOFT = 0.3  # path over which the hose tightens, in lever arms


class Hose(Effect):
    """A hose past two joints: it lengthens as either bends, and pulls once it is tight.

    Its path is longer by s = Σ r (1 − cos(q − φ)) than where it is shortest; its
    tension T = k ln(1 + e^((s − s₀)/w)) is that of a slack that is used up softly. The
    joints feel T ∂s/∂q: what one joint feels depends on where the other is.
    """

    id = "hose"
    port = Port.ENVIRONMENT
    scope = "coupling"
    gains = (Quantity("tension", "N", 1.0, 0.0, 1e3),)
    shapes = (
        Quantity("first_arm", "m", 1.0, 0.0, 1e3),
        Quantity("second_arm", "m", 1.0, 0.0, 1e3),
        Quantity("first_rest", "rad", 0.0, -7.0, 7.0),
        Quantity("second_rest", "rad", 0.0, -7.0, 7.0),
    )
    equation = "τ = k ln(1 + e^((s − s₀)/w)) ∂s/∂q,  s = Σ r (1 − cos(q − φ))"
    source = "an invention of this experiment"
    sentence = "A hose pulls on {joints}."
    remedy = "None: no effect of the library is like it."

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 2, 1)."""
        return self._per_tension(motion.q[:, list(self.joints)])[:, :, None]

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """See :meth:`Effect.resist`; it has no past."""
        return self.values["tension"] * self._per_tension(state.q)

    def _per_tension(self, q: Array) -> Array:
        """Torque at both joints per tension, shape (..., 2)."""
        arms = np.array([self.values[f"{x}_arm"] for x in ("first", "second")])
        bent = q - [self.values[f"{x}_rest"] for x in ("first", "second")]
        length = (1.0 - np.cos(bent)) @ (arms / arms.max())
        tension = _SOFT * np.logaddexp(0.0, (length - 1.0) / _SOFT)
        return np.asarray(arms * np.sin(bent) * tension[..., None])


class Grease(JointEffect):
    """Grease pushed aside about one position: thick elsewhere, shear-thinning.

    The film's profile over position multiplies Eyring's drag asinh(v/v₀).
    """

    id = "grease"
    port = Port.DRIVE
    gains = (Quantity("drag", "N·m", 0.01, 0.0, 1.0, per=(1, 0)),)
    shapes = (
        Quantity("middle", "rad", 0.0, -7.0, 7.0),
        Quantity("width", "rad", 0.5, 0.1, 3.0),
        Quantity("speed", "rad/s", 0.2, 0.01, 10.0),
    )
    equation = "τ = d (1 − e^(−(q − q₀)²/2b²)) asinh(v/v₀)"
    source = "Eyring 1936, doi 10.1063/1.1749836 (drag); the profile is invented"
    sentence = "Grease at {joints} lies unevenly."
    remedy = "None: no effect of the library is like it."

    @staticmethod
    def law(state: JointState, **shapes: Any) -> Sequence[Array]:
        """Torque per N·m of drag."""
        away = (state.q - shapes["middle"]) / shapes["width"]
        film = 1.0 - np.exp(-0.5 * away * away)
        return (film * np.arcsinh(state.v / shapes["speed"]),)


def unmodelled(scales: Sequence[Scale], rng: np.random.Generator) -> list[Effect]:
    """A hose past every two joints and grease in every gear, placed at random.

    Args:
        scales: Size of every joint of the arm.
        rng: Source of the places.
    """
    rated = [scale.torque for scale in scales]
    effects: list[Effect] = []
    for first in range(0, len(scales) - 1, 2):
        second = first + 1
        values = {
            "tension": 1.0,
            "first_arm": HOSE * rated[first],
            "second_arm": HOSE * rated[second],
            "first_rest": rng.uniform(-1.0, 1.0),
            "second_rest": rng.uniform(-1.0, 1.0),
        }
        effects.append(Hose((first, second), values))
    for joint, scale in enumerate(scales):
        values = {
            "drag": GREASE * rated[joint] / np.arcsinh(5.0),
            "middle": rng.uniform(-1.0, 1.0),
            "speed": 0.2 * scale.speed,
        }
        effects.append(Grease((joint,), values))
    return effects
