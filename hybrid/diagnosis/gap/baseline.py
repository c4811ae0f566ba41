"""A model of the healthy arm as the simulator: what has changed since?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap, simulated_torque
from hybrid.dynamics import RigidBody
from hybrid.effects import effect_classes
from hybrid.identification.preparation import motions_from_logs
from hybrid.model import DynamicModel
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion


@dataclass(frozen=True, eq=False)
class Baseline:
    """What a model knows of an arm beyond the numbers of its file.

    Torque of friction, ripple and remainder is taken from the logs. What is left is
    that of the model's links, and of whatever has changed.

    Attributes:
        model: The model of the healthy arm.
    """

    model: DynamicModel

    @cached_property
    def robot(self) -> Robot:
        """The arm with the model's links, if some are consistent with its torque."""
        known = self.model.inertial
        return (
            self.model.robot if known is None else self.model.robot.with_inertial(known)
        )

    @property
    def constant(self) -> list[str]:
        """Ids of effects that do not come about on an arm that was sound."""
        return [x.id for x in effect_classes().values() if x.inborn]

    def taken_from(
        self, logs: Sequence[Recording | Motion]
    ) -> list[Recording | Motion]:
        """Logs less the torque that is known.

        Args:
            logs: Logs of the arm that were checked, or motions made from such.
        """
        motions, _ = motions_from_logs(logs, self.model.cutoff)
        return [
            replace(x, tau=x.tau - self._known(m))
            for x, m in zip(logs, motions, strict=True)
        ]

    def beside(self, gap: Gap) -> Gap:
        """A gap with the size of what was taken: that may be a little wrong."""
        both = zip(gap.motions, gap.samplers, strict=True)
        parts = [sampler(self._known(m)) for m, sampler in both]
        return replace(gap, known=np.concatenate(parts))

    def _known(self, motion: Motion) -> Array:
        """Torque beyond the file's and the links', shape (N, n), [N·m]."""
        body = RigidBody(self.robot.chain, motion)
        return self.model.predict(motion) - simulated_torque(self.robot, motion, body)
