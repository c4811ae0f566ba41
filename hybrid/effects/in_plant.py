"""Hooks with which a plant simulates an effect, from command to sensor."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.effects.state import JointState
from hybrid.errors import EffectError

if TYPE_CHECKING:
    import mujoco

    Spec: TypeAlias = mujoco.MjSpec
else:
    Spec = Any  # MuJoCo is slow to load


class InPlant:
    """An effect in a plant. Each hook is the identity by default.

    B trajectories run together; k is the number of the effect's joints. A plant has the
    latency, the servo gains and the lag of :attr:`actuator` as well.
    """

    id: ClassVar[str]
    # Name of the joint that it adds between motor and link, if it does.
    behind: ClassVar[str] = ""

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add to a MuJoCo spec of the arm what MuJoCo itself can simulate.

        Joint and body of link k, base to tip, share the name ``names[k]``.
        """
        return  # by default nothing

    def added_joint(self, spec: Spec, name: str) -> Any:
        """A new joint after a motor joint, on the same axis, called ``behind``.

        Raises:
            EffectError: The motor joint has no armature: the rotor would be massless.
        """
        motor = spec.joint(name)
        if motor.armature <= 0:
            raise EffectError(
                f"{self.id} at {name!r} needs a rotor: add the armature effect first"
            )
        return spec.body(name).add_joint(
            name=f"{name}/{self.behind}", type=motor.type, axis=motor.axis
        )

    def deliver(self, torque: Array) -> Array:
        """Delivered torque for a commanded one, shape (B, k), [N·m]."""
        return torque

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """Resisting torque with memory at a state of the motors, shape (B, k), [N·m].

        It was ``before`` one step ago, [s], and is 0 at the start.
        """
        return np.zeros_like(before)

    def push(self, t: Array, recording: Index) -> Array:
        """Force and moment of the last link on its environment, shape (B, 6).

        In the base frame; the moment is about the origin of the link's frame. Each
        trajectory has a time, shape (B,), [s], and the number of its recording.
        """
        return np.zeros((len(t), 6))

    def sense(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Position and speed that the encoders show for the true ones; shape (B, k)."""
        return q, v
