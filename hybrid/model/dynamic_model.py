"""The identified model: a sum of terms that predicts joint torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import BaseParameters, RigidBody
from hybrid.effects import Effect
from hybrid.errors import ModelFileError
from hybrid.model.model_file import read_model, write_model
from hybrid.model.program import Program, is_instant, program_from_model, shows_noise
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.signals.filters import LOWER_BAND, butterworth


@dataclass(frozen=True, repr=False)
class DynamicModel:
    """Drive torque = rigid body + effects + learned remainder.

    Attributes:
        robot: The arm.
        base: Base inertial parameters with their values.
        effects: Effects with their values.
        remainder: The learned remainder, or None.
        cutoff: Cut-off of the identification, [Hz].
        standing: Speed below which a joint stands, shape (n,), [rad/s].
        range: Range of the data, by name: ``q_min``, ``q_max`` and ``v_max``, shape
            (n,) each.
        inertial: Physically consistent link parameters with these base values, shape
            (n, 10), or None.
        covariance: Covariance of the base values, shape (b, b), or (0, 0) if unknown.
        simpler: Models of earlier stages and simpler estimators, by name, for
            comparison.
        logs: Hash of each log that it was identified from, by
            :func:`~hybrid.identification.preparation.log_hash`.
        band: Bandwidth of the torque in these logs, [Hz], if a filter had removed what
            is faster.
    """

    robot: Robot
    base: BaseParameters
    effects: tuple[Effect, ...] = ()
    remainder: ArmRemainder | None = None
    cutoff: float = np.inf
    standing: Array = field(default_factory=lambda: np.zeros(0))
    range: Mapping[str, Array] = field(default_factory=dict)
    inertial: Array | None = None
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    simpler: Mapping[str, DynamicModel] = field(default_factory=dict)
    logs: tuple[str, ...] = ()
    band: float = np.inf

    def __getstate__(self) -> dict[str, Any]:
        """What defines it: laws that were compiled are none, and no copy has them."""
        return {x.name: getattr(self, x.name) for x in fields(self)}

    def __repr__(self) -> str:
        found = ", ".join(dict.fromkeys(effect.id for effect in self.effects))
        return f"<DynamicModel of {self.robot.name}, {self.stage}: {found}>"

    @property
    def stage(self) -> str:
        """Name of the last stage of the identification."""
        if self.inertial is not None:
            return "+ consistent"
        if self.remainder is not None:
            return "+ remainder"
        kinds = {effect.id for effect in self.effects}
        if "torque_ripple" in kinds:
            return "+ ripple"
        return "+ friction" if "threshold_friction" in kinds else "rigid"

    @cached_property
    def link_parameters(self) -> Array:
        """Link parameters with the base values, shape (n, 10).

        Physically consistent ones if they are known; else only the torque is right.
        """
        if self.inertial is not None:
            return self.inertial
        n = self.robot.size
        return self.base.standard()[: 10 * n].reshape(n, 10)

    def body(self, motion: Motion) -> RigidBody:
        """The identified rigid body along a motion."""
        return RigidBody(self.robot.chain, motion, self.link_parameters)

    def predict(self, motion: Motion) -> Array:
        """Drive torque along a motion, as the log would show it, (N, n), [N·m]."""
        for effect in self.effects:
            if effect.observes:
                motion = effect.observe(motion, self.body(motion))
        program, others = self._parts
        tau, _ = program.run(motion.q, motion.v, motion.a)
        body = self.body(motion)
        for effect in others:
            tau[:, effect.reaches(tau.shape[1])] += effect.torque(motion, body)
        for effect in self.effects:
            if effect.reports:
                joints = list(effect.joints)
                known = self._known(effect, motion, tau[:, joints])
                tau[:, joints] += effect.report(motion.t, known) - known
        if self.remainder is not None:
            tau += self.remainder.predict(motion.q, motion.v)
        return tau

    def _known(self, effect: Effect, motion: Motion, torque: Array) -> Array:
        """Torque from which an effect makes its change, shape (N, k), [N·m]."""
        if not shows_noise(effect) or len(motion.t) < 2:
            return torque
        return butterworth(torque, rate=motion.rate, cutoff=LOWER_BAND * self.cutoff)

    @cached_property
    def _parts(self) -> tuple[Program, tuple[Effect, ...]]:
        """Laws of one instant as a program, and effects that need a whole motion."""
        split: dict[bool, list[Effect]] = {True: [], False: []}
        for effect in self.effects:
            split[is_instant(self, effect)].append(effect)
        own = replace(self, effects=tuple(split[True]), remainder=None)
        return program_from_model(own), tuple(split[False])

    @typed
    def save(self, path: str | Path) -> None:
        """Write the model to ``path``, a JSON file with a hash of its content.

        Raises:
            ModelFileError: The path does not end in ``.json``, or the model has values
                with which it could not be loaded.
        """
        write_model(self, Path(path))

    @classmethod
    @typed
    def load(cls, path: str | Path) -> DynamicModel:
        """Read a file of :meth:`save`.

        Raises:
            ModelFileError: The file is missing, damaged, edited or of another version,
                or has an unknown effect.
        """
        return read_model(cls, Path(path))


def check_same_arm(model: DynamicModel, robot: Robot) -> None:
    """Refuse a model of another arm.

    Raises:
        ModelFileError: Joints or kinematics differ.
    """
    if model.robot.joints != robot.joints:
        raise ModelFileError(
            f"the model is of joints {', '.join(model.robot.joints)}, "
            f"the robot file has {', '.join(robot.joints)}"
        )
    if model.robot.fingerprint() != robot.fingerprint():
        raise ModelFileError(
            f"the model is of another arm ({model.robot.name}); its kinematics differ "
            f"from {robot.name}"
        )
