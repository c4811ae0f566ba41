"""Effects evaluated at one instant, for models that run in a control loop.

The law is the same as for whole motions, written for scalars: numbers, arrays, or
symbols from which an export makes C or ONNX. Scalars have arithmetic, comparisons and
NumPy's functions, but no branches: use ``np.where``.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from hybrid.arrays import Array
from hybrid.effects.state import JointState
from hybrid.errors import EffectError
from hybrid.signals import Motion

Scalar = Any  # float, array or symbol
Memory = tuple[Scalar, ...]
# Torque of a simulator's joint per unit of each of its fields. Only the preload, which
# is that of a spring, may be negative.
FIELDS: Mapping[str, Callable[[JointState], Scalar]] = {
    "armature": lambda joint: joint.a,
    "damping": lambda joint: joint.v,
    "quadratic": lambda joint: joint.v * abs(joint.v),
    "cubic": lambda joint: joint.v**3,
    "stiffness": lambda joint: joint.q,
    "preload": lambda joint: 1.0 + 0.0 * joint.q,
    "frictionloss": lambda joint: joint.sign,
}
# Fields that are functions of speed; and ``friction``, a curve for which a simulator
# has no field, so that the others approximate it.
FRICTION = ("damping", "quadratic", "cubic", "frictionloss", "friction")


class Instant:
    """An effect at one instant, with a memory of earlier instants.

    Attributes:
        memory: Names of the remembered values.
        not_in_loop: Why a model in a control loop leaves it out; empty if it does not.
        fields: Field of a simulator's joint for each gain, of ``FIELDS``, or
            ``friction``.
    """

    id: ClassVar[str]
    memory: ClassVar[tuple[str, ...]] = ()
    not_in_loop: ClassVar[str] = ""
    fields: ClassVar[Mapping[str, str]] = {}

    @property
    def exact_fields(self) -> Mapping[str, str]:
        """Those of ``fields`` that are exact at the effect's shapes."""
        return self.fields

    @property
    def actuator(self) -> Mapping[str, float]:
        """Equivalent changes of an actuator, by the names of ``Actuator``."""
        return {}

    def rigid_change(self, size: int, gravity: Array) -> tuple[Array, Array] | None:
        """Change of the rigid body with the same torque as the effect, or None.

        It is that of link parameters, shape (n, 10), and of gravity, shape (3,), of an
        arm of size n; gravity is an acceleration in the base frame, [m/s²].
        """
        return None

    def true_state(
        self, q: Scalar, v: Scalar, a: Scalar
    ) -> tuple[Scalar, Scalar, Scalar]:
        """True state of the effect's joint from what its encoder shows."""
        raise self._not_exportable("it changes the motion by its past and future")

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """Memory before the first instant, given the state at it."""
        return ()

    def remembered(self, motion: Motion) -> Sequence[Array]:
        """Its memory at every sample of a motion of the arm, shape (N,) each.

        From it :meth:`at_instant` has the torque of that sample after a step of zero.
        """
        raise EffectError(
            f"{self.id} cannot be replayed: it does not state what it remembers"
        )

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """Torque at the effect's joints, [N·m], and the new memory.

        The last instant, whose memory is given, was a step before, [s]. The default is
        zero for an effect that only changes the commanded torque.
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
        """Logged torque for the torque at its joints, and the new memory."""
        raise self._not_exportable("it reports torque by its past and future")

    def _not_exportable(self, reason: str) -> EffectError:
        return EffectError(f"{self.id} cannot run in a control loop: {reason}")
