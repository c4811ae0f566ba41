"""A joint that twists between motor and link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.fft import next_fast_len

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.errors import EffectError
from hybrid.signals import Motion

if TYPE_CHECKING:
    import mujoco


_REACH = 2.0  # s; by then it has rung out
_LEAST_DAMPING = 0.05  # of the critical one; no gear rings for longer


class Elasticity(Effect):
    """Spring and damper between motor and link: τ = K(θ − q) + D(θ̇ − q̇).

    The encoder sits on the motor. The gain is the compliance 1/K.
    """

    id = "elasticity"
    port = Port.TRANSMISSION
    steep = True
    echoes = True
    # Noise of positions is largest where it swings, which looks like damping.
    inexact: ClassVar[Mapping[str, float]] = {"compliance": 0.05, "damping": 0.5}
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
        """Change of torque over the compliance, at its value.

        See :meth:`Effect.columns`; shape (N, n, 1). A softer spring swings more slowly:
        without a compliance this is the first order, of a link that does not swing.
        """
        return body.response(*self._twist(motion, body))[:, :, None]

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link, which swings on its spring behind the motor."""
        soft = self.values["compliance"]
        if soft <= 0:
            return motion
        dq, dv, da = (soft * x for x in self._twist(motion, body))
        return replace(motion, q=motion.q + dq, v=motion.v + dv, a=motion.a + da)

    def _twist(self, motion: Motion, body: Body) -> tuple[Array, ...]:
        """Position, speed and acceleration of link over motor per compliance, (N, n).

        The spring carries the load of a link that follows by τ_load = K d + D ḋ + M d̈,
        if M, the inertia about the joint, is taken at its mean along the motion.
        """
        (j,) = self.joints
        soft, damping = self.values["compliance"], self.values["damping"]
        if soft == 0:
            place = np.zeros_like(motion.q)
            place[:, j] = -body.load[:, j]
            speed = np.gradient(place, motion.t, axis=0)
            return place, speed, np.gradient(speed, motion.t, axis=0)
        push, none = np.zeros_like(motion.q), np.zeros_like(motion.q)
        push[:, j] = 1.0
        inertia = float(np.mean(body.response(none, none, push)[:, j]))
        step = float(np.median(np.diff(motion.t)))
        drag = np.hypot(damping * soft, 2 * _LEAST_DAMPING * np.sqrt(inertia * soft))
        load = body.load[:, j]
        # Continued by its point reflection, which keeps value and slope at the ends.
        N, reach = len(load), min(len(load) - 1, round(_REACH / step))
        size = int(next_fast_len(N + 2 * reach, real=True))
        after = size - N - reach
        whole = np.pad(load, (reach, after), mode="reflect", reflect_type="odd")
        omega = 2 * np.pi * np.fft.rfftfreq(size, step)
        spectrum = np.fft.rfft(whole) / (
            1.0 + 1j * omega * drag - inertia * soft * omega**2
        )
        out = np.zeros((3, *motion.q.shape))
        for power in range(3):
            turn = spectrum * (1j * omega) ** power
            out[power, :, j] = -np.fft.irfft(turn, size)[reach : reach + N]
        return tuple(out)

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
