"""A joint that twists between motor and link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.errors import EffectError
from hybrid.signals import Motion

if TYPE_CHECKING:
    import mujoco


_LEAST_DAMPING = 0.05  # of the critical one; no gear rings for longer


class Elasticity(Effect):
    """Spring and damper between motor and link: τ = K(θ − q) + D(θ̇ − q̇).

    The encoder sits on the motor. The gain is the compliance 1/K, in which the torque
    is linear to first order.
    """

    id = "elasticity"
    port = Port.TRANSMISSION
    not_in_loop = "its link swings by the load that comes next"
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

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link, which swings on its spring behind the motor.

        The spring carries the load of a link that follows by τ_load = K d + D ḋ + M d̈,
        if M, the inertia about the joint, is taken at its mean along the motion.
        """
        (j,) = self.joints
        soft, damping = self.values["compliance"], self.values["damping"]
        if soft <= 0:
            return motion
        push = np.zeros_like(motion.q)
        push[:, j] = 1.0
        none = np.zeros_like(push)
        inertia = float(np.mean(body.response(none, none, push)[:, j]))
        step = float(np.median(np.diff(motion.t)))
        damping = max(damping, 2 * _LEAST_DAMPING * np.sqrt(inertia / soft))
        load = body.load[:, j]
        # Continued by its point reflection, which keeps value and slope at the ends.
        whole = np.concatenate(
            [2 * load[0] - load[:0:-1], load, 2 * load[-1] - load[-2::-1]]
        )
        omega = 2 * np.pi * np.fft.rfftfreq(len(whole), step)
        spectrum = np.fft.rfft(whole) / (
            1 / soft + 1j * omega * damping - inertia * omega**2
        )
        first, last = len(load) - 1, 2 * len(load) - 1
        q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
        for x, power in ((q, 0), (v, 1), (a, 2)):
            turn = spectrum * (1j * omega) ** power
            x[:, j] -= np.fft.irfft(turn, len(whole))[first:last]
        return replace(motion, q=q, v=v, a=a)

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
