"""Lost motion between motor and link."""

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

# The teeth of a simulated gear meet as hard as MuJoCo's usual step allows.
_CONTACT_TIME = 0.002  # s
# Inertia of what lies between play and motor, of the rotor's: a gear that twists as
# well would otherwise have a massless part between its spring and its stops.
_GEAR = 0.01


class Backlash(Effect):
    """The link lags its motor by half the play, to the side that its load pushes it.

    The encoder sits on the motor. A plant has hard stops. From a log one cannot tell
    how the gap was crossed, so that here it closes smoothly over a small torque, as in
    the definition of lost motion; a simulation has the last word.
    """

    id = "backlash"
    port = Port.TRANSMISSION
    gains = (Quantity("half_width", "rad", 0.001, 0.0, 0.01),)
    shapes = (Quantity("torque", "N·m", 0.03, 0.001, 0.3, per=(1, 0)),)
    equation = "τ = rigid(θ − b · tanh(τ_load/τ_c))"
    source = "Nordin and Gutman 2002, doi 10.1016/S0005-1098(02)00047-X"
    sentence = "The gear of {joints} has play."
    remedy = "Add a limited play joint behind the motor, or preload the gear."

    def reaches(self, size: int) -> tuple[int, ...]:
        """The whole arm: all of it moves when a link lags."""
        return tuple(range(size))

    def columns(self, motion: Motion, body: Body) -> Array:
        """First order in the play; see :meth:`Effect.columns`; shape (N, n, 1)."""
        return body.response(*self._lag(motion, body))[:, :, None]

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link behind the play."""
        dq, dv, da = (self.values["half_width"] * x for x in self._lag(motion, body))
        return replace(motion, q=motion.q + dq, v=motion.v + dv, a=motion.a + da)

    def _lag(self, motion: Motion, body: Body) -> tuple[Array, Array, Array]:
        """Position, speed and acceleration of the link over the motor's per play."""
        (j,) = self.joints
        lag = np.zeros_like(motion.q)
        lag[:, j] = -np.tanh(body.load[:, j] / self.values["torque"])
        speed = np.gradient(lag, motion.t, axis=0)
        return lag, speed, np.gradient(speed, motion.t, axis=0)

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Add a free joint between stops behind the motor joint, on the same axis.

        Raises:
            EffectError: The joint has no armature: the rotor would be massless.
        """
        half = self.values["half_width"]
        if half <= 0:
            return
        name = names[self.joints[0]]
        motor = spec.joint(name)
        if motor.armature <= 0:
            raise EffectError(
                f"backlash at {name!r} needs a rotor: add the armature effect first"
            )
        play = spec.body(name).add_joint(
            name=f"{name}/play", type=motor.type, axis=motor.axis
        )
        play.armature = _GEAR * motor.armature
        play.limited, play.range = True, np.array([-half, half])
        play.solref_limit = np.array([_CONTACT_TIME, 1.0])
        play.solimp_limit[:3] = 0.99, 0.999, 0.1 * half
