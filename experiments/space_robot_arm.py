"""The space robot as an ordinary arm of two links with shared friction."""

from __future__ import annotations

import numpy as np
from improved_stribeck_law import ImprovedStribeck

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointState, Port, Quantity
from hybrid.robot import Robot
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

_LINKS = np.array(
    [[1, 0.5, 0, 0, 0, 0, 0, 0, 0, 1 / 3], [2, 1.5, 0, 0, 0, 0, 0, 0, 0, 2.0]]
)


def arm() -> Robot:
    """Two joints about one axis, a metre apart, no gravity; the payload half known."""
    chain = Chain(
        joints=("first", "second"),
        rotation=np.stack([np.eye(3)] * 2),
        translation=np.array([[0.0, 0, 0], [1, 0, 0]]),
        axis=np.array([[0.0, 0, 1]] * 2),
        revolute=np.array([True, True]),
        inertial=_LINKS,
        gravity=np.zeros(3),
        armature=np.zeros(2),
    )
    free, zero = np.full(2, np.inf), np.zeros(2)
    return Robot(
        "space", chain, -free, free, np.full(2, 3.0), np.full(2, 8.0), zero, zero
    )


class SharedFriction(Effect):
    """Stribeck friction with the same four parameters at every joint."""

    id = "shared_friction"
    port = Port.DRIVE
    scope = "arm"
    gains = ImprovedStribeck.gains
    shapes = (Quantity("velocity", "rad/s", 0.1, 0.01, 1.0),)
    equation, source = ImprovedStribeck.equation, ImprovedStribeck.source
    sentence, remedy = ImprovedStribeck.sentence, ImprovedStribeck.remedy

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, n, 3)."""
        load, v = np.zeros_like(motion.v), motion.v
        state = JointState(load, motion.q, v, motion.a, np.sign(v), load)
        velocity = self.values["velocity"]
        laws = ImprovedStribeck.law(state, velocity=velocity, width=0.0)
        return np.stack(laws, axis=-1)
