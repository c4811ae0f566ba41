"""Simulation of several trajectories of one arm together, step by step."""

import copy
from collections.abc import Sequence

import mujoco
import numpy as np

from hybrid.arrays import Array, Index
from hybrid.effects import Effect, JointState
from hybrid.errors import HybridError
from hybrid.plant.arm import Arm, drives, overrides
from hybrid.plant.laws import Laws, direction

_FASTEST = 1e3  # rad/s; a faster simulation has diverged


class Lockstep:
    """State of B trajectories of an arm of n joints.

    Python code runs once per step for all trajectories; only ``mj_step`` is called for
    each. Dry friction is written to each model's friction loss, so that MuJoCo's
    constraint solver simulates sticking. The other laws are applied as torque.

    Attributes:
        q: Motor position, shape (B, n), [rad].
        v: Motor speed, shape (B, n), [rad/s].
        a: Motor acceleration of the last step, shape (B, n), [rad/s²].
        load: Torque transmitted to the links in the last step, shape (B, n), [N·m].
        temperature: Temperature of the drives, shape (B, n), [°C], where it is known.
        recordings: Number of each trajectory's recording, shape (B,).
    """

    temperature: Array | None = None

    def __init__(
        self, arm: Arm, effects: Sequence[Effect], start: Array, *, time: float = 0.0
    ) -> None:
        """Place every trajectory at rest, at motor positions of shape (B, n), [rad]."""
        self._arm = arm
        batch, n = start.shape
        self.recordings: Index = np.arange(batch)
        self._laws = Laws(effects, batch, n)
        self._drives = [(e, e.actuator.get("lag", 0.0)) for e in effects if drives(e)]
        self._pushing = [e for e in effects if overrides(e, "push")]
        # Whether a torque that is held acts on the arm as it is, and nothing else does.
        self._plain = not (len(self._laws) or self._drives or self._pushing)
        self._before: dict[int, Array] = {}  # torque of lagging drives one step ago
        self._models = [copy.copy(arm.model) for _ in range(batch)]
        self._datas = [mujoco.MjData(model) for model in self._models]
        for data in self._datas:
            data.time = time
        self._declared = arm.model.dof_frictionloss.copy()
        self._motion = self._views("qpos", "qvel")
        self._torques = self._views(
            "qacc", "qfrc_smooth", "qfrc_passive", "qfrc_constraint"
        )
        self._forces = self._views("qfrc_applied")
        # Whether the dofs are the motors, one by one, so that nothing is to be picked.
        self._alike = np.array_equal(arm.motor, np.arange(arm.model.nv))
        self._motor = slice(None) if self._alike else arm.motor
        self._levels = [model.dof_frictionloss for model in self._models]
        self._applied = np.zeros((batch, arm.model.nv))
        self._friction = np.tile(self._declared, (batch, 1))
        self._time = np.zeros((batch, n))
        self._settle(start)
        self.a = np.zeros((batch, n))
        self.load = np.zeros((batch, n))
        self._net_torque = np.zeros((batch, n))
        self._read()

    def _settle(self, start: Array) -> None:
        """Set deflections to equilibrium with gravity."""
        arm = self._arm
        joint = arm.model.dof_jntid[arm.deflection]
        stiffness, stop = arm.model.jnt_stiffness[joint], arm.model.jnt_range[joint, 1]
        soft = stiffness > 0
        for model, data, q in zip(self._models, self._datas, start, strict=True):
            data.qpos[arm.motor] = q
            for _ in range(4 if len(arm.deflection) else 1):
                mujoco.mj_forward(model, data)
                bias = data.qfrc_bias[arm.deflection]
                twist = bias / np.where(soft, stiffness, 1.0)
                data.qpos[arm.deflection] = -np.where(soft, twist, np.sign(bias) * stop)

    def step(self, torque: Array, substeps: int = 1) -> None:
        """Advance some physics steps with a torque held, shape (B, n), [N·m].

        Raises:
            HybridError: The simulation diverges.
        """
        count = substeps if self._plain else 1  # of physics steps at a time
        for left in range(substeps - count, -1, -count):
            delivered = self._delivered(torque)
            self._act(delivered)
            for model, data in zip(self._models, self._datas, strict=True):
                mujoco.mj_step(model, data, count)
            self._read()
            if len(self._laws) or not left:  # without laws nobody asks in between
                self._read_torque(delivered)

    def _delivered(self, torque: Array) -> Array:
        if not self._drives:
            return torque
        delivered, step = torque.copy(), self._arm.model.opt.timestep
        for k, (effect, lag) in enumerate(self._drives):
            j = list(effect.joints)
            now = effect.deliver(delivered[:, j])
            if lag:  # steady at the start
                now = lagged(now, self._before.get(k, now), lag, step)
                self._before[k] = now
            delivered[:, j] = now
        return delivered

    def _act(self, delivered: Array) -> None:
        """Write applied torque and friction levels into MuJoCo."""
        arm, laws, applied = self._arm, self._laws, self._applied
        if not len(laws):
            applied[:, self._motor] = delivered
        else:
            motor, link = self._states()
            laws.evaluate(motor, link, arm.model.opt.timestep)
            applied[:, self._motor] = delivered - laws.drive - laws.link
            if len(arm.elastic):
                applied[:, arm.deflection] = -laws.link[:, arm.elastic]
            # A single law may be negative; only the sum must not be.
            level = self._declared[self._motor] + motor.sign * laws.dry
            self._friction[:, self._motor] = np.maximum(level, 0.0)
            for target, row in zip(self._levels, self._friction, strict=True):
                target[:] = row
        for force, row in zip(self._forces, applied, strict=True):
            force[:] = row
        if self._pushing:
            self._push()

    def _push(self) -> None:
        """Apply the forces of the environment to the last link."""
        tip, where = self._arm.tip, (self._now, self.recordings)
        wrenches = -np.sum([e.push(*where) for e in self._pushing], axis=0)
        for data, wrench in zip(self._datas, wrenches, strict=True):
            data.xfrc_applied[tip] = wrench
            if wrench.any():  # MuJoCo needs the moment about the centre of mass
                lever = data.xpos[tip] - data.xipos[tip]
                data.xfrc_applied[tip, 3:] += np.cross(lever, wrench[:3])

    def _states(self) -> tuple[JointState, JointState]:
        """States on the motor's and on the link's side, as inputs of the laws."""
        # A joint held by friction creeps in the direction of the net torque already.
        sign = direction(self.v, self._net_torque)
        self._time[:] = self._now[:, None]
        warm = self.temperature
        motor = JointState(self._time, self.q, self.v, self.a, sign, self.load, warm)
        elastic = self._arm.elastic
        if not len(elastic):
            return motor, motor
        q, v = self.q.copy(), self.v.copy()
        for x, all_dofs in zip((q, v), self._gather(self._motion), strict=True):
            np.add.at(x.T, elastic, all_dofs[:, self._arm.deflection].T)
        return motor, JointState(self._time, q, v, self.a, np.sign(v), self.load, warm)

    def _read(self) -> None:
        self.q, self.v = self._of_motors(self._gather(self._motion))
        self._check_speed()

    def _check_speed(self) -> None:
        # The comparison is written so that NaN fails it too.
        if not np.vdot(self.v, self.v) < _FASTEST**2 * self.v.size:
            raise HybridError(
                f"the simulation diverges at {self._datas[0].time:.3f} s; use a "
                "smaller step, or check effects and gains against the arm's inertia"
            )

    def _read_torque(self, delivered: Array) -> None:
        """Read acceleration, net torque and transmitted load for the next step."""
        arm, all_dofs = self._arm, self._gather(self._torques)
        self.a, self._net_torque, passive, stop = self._of_motors(all_dofs)
        held = delivered - self._laws.drive + passive + stop
        self.load = held - arm.armature * self.a
        if len(arm.elastic):
            # With a spring or backlash, the load is the torque that these transmit.
            passive, stop = all_dofs[2:, :, arm.deflection]
            self.load[:, arm.elastic] = passive + stop

    @property
    def _now(self) -> Array:
        """Time of each trajectory, shape (B,), [s]."""
        return np.array([data.time for data in self._datas])

    def _views(self, *names: str) -> list[Array]:
        """Vectors in MuJoCo's memory, those of all trajectories name by name."""
        return [getattr(data, name) for name in names for data in self._datas]

    def _gather(self, views: list[Array]) -> Array:
        """Copies of vectors of all dofs, shape (names, B, dofs), in one call."""
        nv = self._arm.model.nv
        return np.concatenate(views).reshape(-1, len(self._datas), nv)

    def _of_motors(self, all_dofs: Array) -> Array:
        return all_dofs if self._alike else all_dofs.take(self._arm.motor, axis=2)


def lagged(torque: Array, before: Array, lag: float, step: float) -> Array:
    """One implicit Euler step of a lag, whose delay is exact for any step."""
    return before + (torque - before) * step / (lag + step)
