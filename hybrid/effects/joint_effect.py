"""Laws that depend on the state of one joint only."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.effect import Effect
from hybrid.effects.instant import FIELDS, Memory, Scalar
from hybrid.effects.state import Body, JointState
from hybrid.signals import Motion


class JointEffect(Effect):
    """A law of one joint's state without memory, the same for plant and fit.

    ``dry`` marks laws of dry friction, which depend on the direction of motion: a plant
    simulates them as a constraint that sticks, not as a torque.
    """

    dry: ClassVar[bool] = False

    @staticmethod
    @abstractmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of each gain, with the shape of the arrays of ``state``."""

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 1, p)."""
        (j,) = self.joints
        q, v, a = motion.q[:, j], motion.v[:, j], motion.a[:, j]
        warm = None if motion.temperature is None else motion.temperature[:, j]
        state = JointState(motion.t, q, v, a, np.sign(v), body.load[:, j], warm)
        laws = np.empty((len(self.gains), 1, len(v)))
        for k, x in enumerate(self.law(state, **self.shape_values)):
            laws[k] = x
        return laws.T

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """The same law; see :meth:`Instant.at_instant`."""
        laws = self.law(joints[0], **self.shape_values)
        terms = zip(self.gains, laws, strict=True)
        return [
            sum(self.values[g.name] * x for g, x in terms if self.values[g.name])
        ], ()


def law_of_fields(fields: Mapping[str, str]) -> Any:
    """The law of an effect whose gains are fields of a simulator's joint."""

    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        return [FIELDS[field](state) for field in fields.values()]

    return staticmethod(law)


def continued(speed: Scalar, fastest: Scalar, power: int) -> Scalar:
    """A power of speeds, 0 or more, [rad/s], and its tangent beyond the fastest."""
    seen = np.minimum(speed, fastest)
    return (seen + power * (speed - seen)) * seen ** (power - 1)
