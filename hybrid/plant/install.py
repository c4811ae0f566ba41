"""Effects and learned torque added to a running MuJoCo simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import mujoco
import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect, JointState
from hybrid.effects.instant import FIELDS
from hybrid.errors import HybridError
from hybrid.plant.arm import IMPEDANCE, has_hook, overrides
from hybrid.plant.joint_fields import soft_springs, split_effects
from hybrid.plant.laws import Laws, direction
from hybrid.robot.actuators import motors_of
from hybrid.robot.mjcf import knee_slope, sum_tendons
from hybrid.robot.robot import Robot

_OWN = (
    "dof_damping", "dof_dampingpoly", "dof_frictionloss", "jnt_stiffness",
    "qpos_spring", "dof_solref", "dof_solimp", "tendon_frictionloss",
    "tendon_stiffness", "tendon_stiffnesspoly", "actuator_biasprm", "actuator_dynprm",
)  # fmt: skip


class _Model(Protocol):
    """The part of a dynamic model that is used here."""

    @property
    def robot(self) -> Robot: ...
    @property
    def effects(self) -> tuple[Effect, ...]: ...
    @property
    def remainder(self) -> Any: ...


class Installed:
    """The torque added to one simulation, until ``remove`` is called.

    Attributes:
        left_out: Effects that cannot be added as torque.
    """

    def __init__(self, model: Any, data: Any, dynamic_model: _Model) -> None:
        robot = dynamic_model.robot
        self._data, self._remainder = data, dynamic_model.remainder
        self._dof = _dofs(model, robot.joints)
        effects = [
            e
            for e in dynamic_model.effects
            if e.rigid_change(robot.size, robot.chain.gravity) is None
        ]
        values, rest = split_effects(effects, FIELDS, robot.size)
        self._model = model
        self._before = {name: getattr(model, name).copy() for name in _OWN}
        self._set_fields(values)
        rest = [e for e in rest if not overrides(e, "edit_spec")]
        self._laws = Laws(rest, 1, robot.size)
        self._declared = model.dof_frictionloss.copy()
        self._time, self._added, self._armature = -np.inf, 0.0, 0.0
        hooked = [e for e in rest if has_hook(e) and not overrides(e, "resist")]
        # Effects of an actuator are in the exported file.
        self.left_out = tuple(e.id for e in hooked if not e.actuator)

    def _set_fields(self, values: Mapping[str, Array]) -> None:
        """Replace the file's approximate friction by that of the model."""
        model, dof = self._model, self._dof
        joints = model.dof_jntid[dof]
        stiffness, relaxed = soft_springs(values["stiffness"], values["preload"])
        model.jnt_stiffness[joints] = stiffness
        model.qpos_spring[model.jnt_qposadr[joints]] = relaxed
        model.dof_damping[dof] = values["damping"]
        model.dof_dampingpoly[dof] = np.c_[values["quadratic"], values["cubic"]]
        model.dof_frictionloss[dof] = values["frictionloss"]
        rising = [d for d in dof if np.isfinite(knee_slope(model)[d])]
        model.dof_solref[rising] = 2.0 * model.opt.timestep, 1.0
        model.dof_solimp[rising, :2] = IMPEDANCE
        sums = sum_tendons(model)
        single = [t for t, own, _ in sums if len(own) == 1 and own[0] in joints]
        model.tendon_frictionloss[single] = 0.0
        model.tendon_stiffness[single] = model.tendon_stiffnesspoly[single] = 0.0
        passive = motors_of(model, driven=False)
        motors = [a for a, joint, _ in passive if joint in joints]
        for size in (0, 3, 4):  # of cogging, and of bristles' friction
            model.actuator_biasprm[motors, size] = 0.0
        model.actuator_dynprm[motors, 6] = 0.0  # damping of bristles

    def remove(self) -> None:
        """Restore the simulation, if that has not been done."""
        if _INSTALLED.get(id(self._data)) is not self:
            return
        for name, x in self._before.items():
            getattr(self._model, name)[:] = x
        del _INSTALLED[id(self._data)]
        if not _INSTALLED:
            mujoco.set_mjcb_passive(None)

    def add(self, model: Any, data: Any) -> None:
        """Add the torque to passive forces, and set friction for the next step."""
        dof = self._dof
        q = data.qpos[model.jnt_qposadr[model.dof_jntid[dof]]][None]
        v, a = data.qvel[dof][None], data.qacc[dof][None]
        sign, t = direction(v, data.qfrc_smooth[dof]), np.full_like(q, data.time)
        state = JointState(t, q, v, a, sign, self._load(data, a))
        self._laws.evaluate(state, state, data.time - self._time)
        torque, self._time = self._laws.drive + self._laws.link, data.time
        if self._remainder is not None:
            torque = torque + self._remainder.predict(q, v)
        data.qfrc_passive[dof] -= torque[0]
        self._added = torque[0]
        level = self._declared[dof] + (sign * self._laws.dry)[0]
        model.dof_frictionloss[dof] = np.maximum(level, 0.0)
        self._armature = model.dof_armature[dof]

    def _load(self, data: Any, a: Array) -> Array:
        """Torque transmitted to the links in the last step."""
        dof = self._dof
        driven = data.qfrc_actuator[dof] + data.qfrc_applied[dof]
        kept = data.qfrc_passive[dof] + data.qfrc_constraint[dof] - self._added
        return np.asarray((driven + kept)[None] - self._armature * a)


_INSTALLED: dict[int, Installed] = {}


def install(
    model: mujoco.MjModel, data: mujoco.MjData, dynamic_model: _Model
) -> Installed:
    """Add the effects that MJCF cannot express to a running simulation.

    An exported MJCF file has the links, rotors, viscous and dry friction of a model,
    and an approximation of friction curves. This replaces the approximation by the
    curve, and adds the other effects and the learned torque. It uses MuJoCo's
    passive-force callback, of which a process has only one: other code that sets the
    callback removes this. What was installed in the simulation before is removed.

    Args:
        model: The exported MJCF file, compiled; it may contain other bodies too.
        data: The simulation.
        dynamic_model: The model that was exported.

    Returns:
        A handle with ``remove()``.

    Raises:
        HybridError: A joint of the model is not in the simulation.
    """
    if (earlier := _INSTALLED.get(id(data))) is not None:
        earlier.remove()
    installed = Installed(model, data, dynamic_model)
    _INSTALLED[id(data)] = installed
    mujoco.set_mjcb_passive(_add)
    return installed


def _add(model: Any, data: Any) -> None:
    installed = _INSTALLED.get(id(data))
    if installed is not None:
        installed.add(model, data)


def _dofs(model: Any, joints: Sequence[str]) -> Any:
    known = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    missing = [name for name in joints if name not in known]
    if missing:
        raise HybridError(
            f"the simulation has no joint {', '.join(missing)}; its joints are "
            f"{', '.join(known)}"
        )
    return np.array([known[name] for name in joints])
