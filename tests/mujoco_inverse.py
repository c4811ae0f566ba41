"""Inverse dynamics of a whole MJCF file by MuJoCo, to compare with ours."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.actuators import motors_of
from hybrid.robot.mjcf import joint_numbers
from hybrid.robot.mujoco_model import compile_file
from hybrid.signals import Motion


def file_inverse_dynamics(
    file: str | Path,
    joints: Sequence[str],
    motion: Motion,
    held: Mapping[str, float],
) -> Array:
    """Torque of MuJoCo's inverse dynamics along a motion, shape (N, n), [N·m].

    Dry friction is taken at the speed at the start of a step, and in steady sliding.
    Joints beside the arm are held at positions, [rad or m].

    Raises:
        RobotError: The file does not compile.
    """
    import mujoco

    model = compile_file(file)
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONTACT) | int(off.mjDSBL_LIMIT)
    data, index = mujoco.MjData(model), joint_numbers(model, joints)
    motors = list(motors_of(model, driven=False))
    places, dofs = model.jnt_qposadr[index], model.jnt_dofadr[index]
    data.qpos[model.jnt_qposadr[joint_numbers(model, held)]] = [*held.values()]
    torque = np.empty_like(motion.q)
    for k in range(len(motion.t)):
        data.qpos[places], data.qvel[dofs] = motion.q[k], motion.v[k]
        data.qacc[dofs] = 0.0
        mujoco.mj_inverse(model, data)
        dry = data.qfrc_constraint[dofs].copy()
        data.qacc[dofs] = motion.a[k]
        mujoco.mj_inverse(model, data)
        _slide(model, data, motors)
        mujoco.mj_fwdActuation(model, data)
        for a, joint, gear in motors:
            data.qfrc_inverse[model.jnt_dofadr[joint]] -= gear * data.actuator_force[a]
        torque[k] = (data.qfrc_inverse + data.qfrc_constraint)[dofs] - dry
    return torque


def _slide(model: Any, data: Any, motors: Sequence[tuple[int, int, float]]) -> None:
    """Set the bristles of LuGre friction to their deflection in steady sliding."""
    for a, _, _ in motors:
        level, static, speed = model.actuator_biasprm[a, 3:6]
        stiffness = model.actuator_dynprm[a, 5]
        if stiffness > 0:
            v = data.actuator_velocity[a]
            fallen = np.exp(-((v / speed) ** 2)) if speed > 0 else 0.0
            most = level + (static - level) * fallen
            data.act[model.actuator_actadr[a]] = np.sign(v) * most / stiffness
