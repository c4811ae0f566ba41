"""A joint that twists between motor and link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.errors import EffectError
from hybrid.signals import Motion

if TYPE_CHECKING:
    import mujoco


class Elasticity(Effect):
    """Spring and damper between motor and link: τ = K(θ − q) + D(θ̇ − q̇).

    The encoder sits on the motor. The gain is the compliance 1/K, in which the torque
    is linear to first order.
    """

    id = "elasticity"
    port = Port.TRANSMISSION
    gains = (Quantity("compliance", "rad/(N·m)", 0.01, 0.0, 0.2, per=(-1, 0)),)
    shapes = (Quantity("damping", "N·m·s/rad", 0.02, 0.0, 1.0, per=(1, -1)),)
    equation = "τ = K (θ − q) + D (dθ/dt − dq/dt)"
    source = "Spong 1987, doi 10.1115/1.3143860"
    sentence = "The gear of {joints} twists under load."
    remedy = "Add a joint spring between motor and link in the simulator."

    def reaches(self, size: int) -> tuple[int, ...]:
        """The whole arm: see :meth:`Effect.reaches`."""
        return tuple(range(size))

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order: rigid torque along the deflection −τ_load of unit compliance."""
        (j,) = self.joints
        twist = np.zeros_like(motion.q)
        twist[:, j] = -body.load[:, j]
        speed = np.gradient(twist, motion.t, axis=0)
        rush = np.gradient(speed, motion.t, axis=0)
        return body.response(twist, speed, rush)[:, :, None]

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Add a deflection joint behind the motor joint, on the same axis.

        Raises:
            EffectError: The joint has no armature: the rotor would be massless.
        """
        if self.values["compliance"] <= 0:
            return
        name = names[self.joints[0]]
        motor = spec.joint(name)
        if motor.armature <= 0:
            raise EffectError(
                f"elasticity at {name!r} needs a rotor: add the armature effect first"
            )
        spring = spec.body(name).add_joint(
            name=f"{name}/deflection", type=motor.type, axis=motor.axis
        )
        spring.stiffness = np.array([1.0 / self.values["compliance"], 0.0, 0.0])
        spring.damping = np.array([self.values["damping"], 0.0, 0.0])
