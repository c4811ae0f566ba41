"""All trajectories of one arm, advanced together step by step."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid.effects import Effect, JointState
from hybrid.errors import HybridError
from hybrid.plant.arm import Arm, overrides
from hybrid.plant.laws import Laws
from hybrid.robot.chain import Array

# Nothing real turns this fast: the simulation has diverged.
_FASTEST = 1e3  # rad/s


class Lockstep:
    """State of B trajectories of an arm of n joints.

    Python runs once per step for all trajectories; only ``mj_step`` itself is called
    for each. Dry laws are written to each model's friction loss, so that MuJoCo's
    constraint solver does the sticking; the other laws are applied torque.

    Attributes:
        q: Motor position, shape (B, n), [rad].
        v: Motor speed, shape (B, n), [rad/s].
        a: Motor acceleration of the last step, shape (B, n), [rad/s²].
        load: Torque transmitted to the links in the last step, shape (B, n), [N·m].
    """

    def __init__(self, arm: Arm, effects: Sequence[Effect], start: Array) -> None:
        """Place every trajectory at rest.

        Args:
            arm: The arm.
            effects: Effects on it.
            start: Motor position of each trajectory, shape (B, n), [rad].
        """
        import mujoco

        self._advance = mujoco.mj_step
        self._arm = arm
        batch, n = start.shape
        self._laws = Laws(effects, batch, n)
        self._drives = [e for e in effects if overrides(e, "deliver")]
        self._models = [copy.copy(arm.model) for _ in range(batch)]
        self._datas = [mujoco.MjData(model) for model in self._models]
        self._declared = arm.model.dof_frictionloss.copy()
        self._views: dict[str, list[Array]] = {
            name: [getattr(data, name) for data in self._datas]
            for name in ("qpos", "qvel", "qacc", "qfrc_passive", "qfrc_constraint",
                         "qfrc_smooth", "qfrc_applied")
        }  # fmt: skip
        self._levels = [model.dof_frictionloss for model in self._models]
        self._applied = np.zeros((batch, arm.model.nv))
        self._friction = np.tile(self._declared, (batch, 1))
        self._time = np.zeros((batch, n))
        self._balance(start)
        self.a = np.zeros((batch, n))
        self.load = np.zeros((batch, n))
        self._tendency = np.zeros((batch, n))
        self._read()

    def _balance(self, start: Array) -> None:
        """Let elastic joints hang in equilibrium with gravity."""
        import mujoco

        arm = self._arm
        stiffness = arm.model.jnt_stiffness[arm.model.dof_jntid[arm.deflection]]
        for model, data, q in zip(self._models, self._datas, start, strict=True):
            data.qpos[arm.motor] = q
            for _ in range(4 if len(arm.deflection) else 1):
                mujoco.mj_forward(model, data)
                bias = data.qfrc_bias[arm.deflection]
                data.qpos[arm.deflection] = -bias / stiffness

    def step(self, torque: Array, substeps: int = 1) -> None:
        """Advance with a torque held.

        Args:
            torque: Torque the drives believe to deliver, shape (B, n), [N·m].
            substeps: Number of physics steps.

        Raises:
            HybridError: The simulation diverges.
        """
        delivered = self._delivered(torque)
        for _ in range(substeps):
            self._act(delivered)
            for model, data in zip(self._models, self._datas, strict=True):
                self._advance(model, data)
            self._read()
            self._read_torque(delivered)

    def _delivered(self, torque: Array) -> Array:
        if not self._drives:
            return torque
        delivered = torque.copy()
        for effect in self._drives:
            for j in effect.joints:
                delivered[:, j] = effect.deliver(delivered[:, j])
        return delivered

    def _act(self, delivered: Array) -> None:
        """Write applied torque and friction levels into MuJoCo."""
        arm, laws, applied = self._arm, self._laws, self._applied
        if not len(laws):
            applied[:, arm.motor] = delivered
        else:
            motor, link = self._states()
            laws.evaluate(motor, link)
            applied[:, arm.motor] = delivered - laws.drive - laws.link
            applied[:, arm.deflection] = -laws.link[:, arm.elastic]
            # One direction's law may be negative; only the sum cannot be.
            level = self._declared[arm.motor] + motor.sign * laws.dry
            self._friction[:, arm.motor] = np.maximum(level, 0.0)
            for target, row in zip(self._levels, self._friction, strict=True):
                target[:] = row
        for force, row in zip(self._views["qfrc_applied"], applied, strict=True):
            force[:] = row

    def _states(self) -> tuple[JointState, JointState]:
        """What the laws see, on the motor's and on the link's side."""
        # A joint at perfect rest is about to move where the other torques push it. One
        # held by friction creeps that way, so that its speed has the sign already.
        push = np.where(self._tendency < 0.0, -1.0, 1.0)
        sign = np.where(self.v == 0.0, push, np.sign(self.v))
        self._time.fill(self._datas[0].time)
        motor = JointState(self._time, self.q, self.v, self.a, sign, self.load)
        elastic = self._arm.elastic
        if not len(elastic):
            return motor, motor
        q, v = self.q.copy(), self.v.copy()
        q[:, elastic] += self._gather("qpos")[:, self._arm.deflection]
        v[:, elastic] += self._gather("qvel")[:, self._arm.deflection]
        return motor, JointState(self._time, q, v, self.a, np.sign(v), self.load)

    def _read(self) -> None:
        self.q = self._gather("qpos")[:, self._arm.motor]
        self.v = self._gather("qvel")[:, self._arm.motor]
        # The comparison is written so that NaN fails it too.
        if not np.vdot(self.v, self.v) < _FASTEST**2 * self.v.size:
            raise HybridError(
                f"the simulation diverges at {self._datas[0].time:.3f} s; use a "
                "smaller step, or check effects and gains against the arm's inertia"
            )

    def _read_torque(self, delivered: Array) -> None:
        """What laws of the next step need: acceleration, push and transmitted load."""
        arm, motor = self._arm, self._arm.motor
        passive = self._gather("qfrc_passive")
        self.a = self._gather("qacc")[:, motor]
        self._tendency = self._gather("qfrc_smooth")[:, motor]
        self.load = (
            delivered - self._laws.drive
            + passive[:, motor]
            + self._gather("qfrc_constraint")[:, motor]
            - arm.armature * self.a
        )  # fmt: skip
        # Behind a spring the load is what the spring passes on.
        self.load[:, arm.elastic] = passive[:, arm.deflection]

    def _gather(self, name: str) -> Any:
        return np.concatenate(self._views[name]).reshape(len(self._datas), -1)
