"""Effects evaluated at one instant, for models that run in a control loop.

The same law as for whole motions, written for scalars: numbers, arrays, or the symbols
of which an export makes C or ONNX. Scalars know arithmetic, comparisons and NumPy's
functions, and cannot be branched on: use ``np.where``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from hybrid.arrays import Array
from hybrid.effects.state import JointState
from hybrid.errors import EffectError

Scalar = Any  # float, array or symbol
Memory = tuple[Scalar, ...]
# What a joint of a simulator may have: τ = armature·a + damping·v + quadratic·v|v|
# + cubic·v³ + stiffness·q + preload + frictionloss·sgn v, none of them negative but the
# preload, which is that of a spring.
FIELDS = (
    "armature", "damping", "quadratic", "cubic", "stiffness", "preload", "frictionloss",
)  # fmt: skip
# Of these, what makes a curve over speed; and ``friction``, a curve for which a
# simulator has no field, and the others stand in.
FRICTION = ("damping", "quadratic", "cubic", "frictionloss", "friction")


class Instant:
    """An effect at one instant, with a memory of earlier instants.

    Attributes:
        memory: Names of what it remembers.
        not_in_loop: Why a model in a control loop leaves it out; empty if it does not.
        fields: Gains that a simulator's joint has a field for, as ``FIELDS``, and those
            that are ``friction``.
    """

    id: ClassVar[str]
    memory: ClassVar[tuple[str, ...]] = ()
    not_in_loop: ClassVar[str] = ""
    fields: ClassVar[Mapping[str, str]] = {}

    @property
    def exact_fields(self) -> Mapping[str, str]:
        """Those of ``fields`` that say the same at the effect's shapes."""
        return self.fields

    @property
    def actuator(self) -> Mapping[str, float]:
        """Equivalent changes of an actuator, by the names of ``Actuator``."""
        return {}

    def setting(self, kp: float, kd: float) -> str:
        """How a servo is given it, in words; nothing if it is not of the servo.

        Args:
            kp: Stiffness as declared, [N·m/rad].
            kd: Damping as declared, [N·m·s/rad].
        """
        return ""

    def rigid_change(self, size: int, gravity: Array) -> tuple[Array, Array] | None:
        """Change of the rigid body with the same torque as the effect, or None.

        Args:
            size: Number of joints n of the arm.
            gravity: Acceleration of gravity in the base frame, shape (3,), [m/s²].

        Returns:
            Change of link parameters, shape (n, 10), and of gravity, shape (3,).
        """
        return None

    def true_state(
        self, q: Scalar, v: Scalar, a: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Motion of the effect's one joint, from what its encoder shows."""
        raise self._not_exportable("it changes the motion by its past and future")

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """Memory before the first instant, given the state at it."""
        return ()

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """Torque at the effect's joints, [N·m], and what to remember.

        Args:
            joints: State of each of the effect's joints.
            memory: What it remembers of the last instant.
            step: Time since then, [s].

        By itself nothing, for an effect that only changes what the drive is asked for.
        """
        if self.asks:
            return [0.0] * len(joints), memory
        raise self._not_exportable("it states no torque at one instant")

    @property
    def asks(self) -> bool:
        """Whether the commanded torque differs from the torque that the arm needs."""
        return type(self).report_at_instant is not Instant.report_at_instant

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """What the log shows of torques at its joints, and what to remember."""
        raise self._not_exportable("it reports torque by its past and future")

    def _not_exportable(self, reason: str) -> EffectError:
        return EffectError(f"{self.id} cannot run in a control loop: {reason}")
