"""MJCF file -> chain and declared properties, compiled by MuJoCo itself.

Compiling with MuJoCo, rather than parsing the XML a second way, keeps defaults,
includes, angle units and geometry-derived inertias exactly as MuJoCo sees them.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.errors import HybridWarning, RobotError
from hybrid.names import printable
from hybrid.robot.chain import Chain
from hybrid.robot.selection import serial_joints
from hybrid.robot.spatial import inertial_about, rotation_from_axis_angle

_SLIDE, _HINGE = 2, 3  # mjtJoint; mujoco itself is imported only when a file is read


def read_mjcf(path: Path, joints: tuple[str, ...] | None) -> dict[str, Any]:
    """Fields of a :class:`~hybrid.robot.robot.Robot` read from an MJCF file.

    Velocity and acceleration limits, which MJCF has no place for, are read from the
    custom numerics ``velocity_limit`` and ``acceleration_limit`` (one value a joint).

    Raises:
        RobotError: The file does not compile, or holds no serial arm.
    """
    model = compiled(path)
    names = [model.joint(j).name or f"joint_{j + 1}" for j in range(model.njnt)]
    for name, kind in zip(names, model.jnt_type, strict=True):
        if kind not in (_SLIDE, _HINGE):
            raise RobotError(
                f"{path}: joint {name!r} is free or ball; valid are hinge and slide "
                "joints on a fixed base"
            )
    parents = {name: _parent(model, j, names) for j, name in enumerate(names)}
    keep = serial_joints(parents, joints, path)
    index = [names.index(name) for name in keep]
    chain = _chain(model, index, keep)
    _warn_left_out(model, path)
    low, high = model.jnt_range[index].T
    limited = model.jnt_limited[index].astype(bool)
    dofs = model.jnt_dofadr[index]
    kp, kd = _servo_gains(model)
    return {
        "name": path.stem,
        "chain": chain,
        "q_min": np.where(limited, low, -np.inf),
        "q_max": np.where(limited, high, np.inf),
        "v_max": _numeric(model, "velocity_limit", index, path),
        "a_max": _numeric(model, "acceleration_limit", index, path),
        "tau_max": _torque_limit(model, index),
        "damping": model.dof_damping[dofs].copy(),
        "frictionloss": model.dof_frictionloss[dofs].copy(),
        "kp": kp[index],
        "kd": kd[index],
        "timestep": float(model.opt.timestep),
    }


def compiled(path: str | Path) -> Any:
    """MuJoCo's model of a file; of what MuJoCo warns, it is a fault.

    Raises:
        RobotError: The file does not compile.
    """
    import mujoco

    # Without a listener MuJoCo leaves a log in the folder that one happens to be in.
    said: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(said.append)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, OSError, mujoco.FatalError) as error:
        said.append(str(error))
    finally:
        mujoco.set_mju_user_warning(before)
    if said:
        reason = printable(" ".join(" ".join(said).split()))
        raise RobotError(f"{path}: not a readable MJCF ({reason})")
    return model


def _warn_left_out(model: Any, path: Path) -> None:
    """What MuJoCo simulates and neither a chain nor its two frictions can hold."""
    left_out = {
        "joint springs": (model.jnt_stiffness != 0).any(),
        "nonlinear joint damping": (model.dof_dampingpoly != 0).any(),
        "gravity compensation": (model.body_gravcomp != 0).any(),
        "a fluid": model.opt.density > 0 or model.opt.viscosity > 0,
        "tendons": model.ntendon > 0,
        "equality constraints": model.neq > 0,
    }
    found = [name for name, there in left_out.items() if there]
    if found:
        warnings.warn(
            f"{path.name}: {', '.join(found)} are not part of a rigid serial arm and "
            "are left out",
            HybridWarning,
            stacklevel=4,
        )


def _parent(model: Any, joint: int, names: list[str]) -> str | None:
    """Nearest joint towards the base; joints of one body follow each other."""
    body = int(model.jnt_bodyid[joint])
    if joint > int(model.body_jntadr[body]):
        return names[joint - 1]
    body = model.body_parentid[body]
    while body > 0:
        if model.body_jntnum[body]:
            return names[int(model.body_jntadr[body] + model.body_jntnum[body]) - 1]
        body = int(model.body_parentid[body])
    return None


def _chain(model: Any, index: list[int], names: tuple[str, ...]) -> Chain:
    """Walk the bodies; everything that does not move is welded to its parent link."""
    n = len(index)
    rotation, translation = np.zeros((n, 3, 3)), np.zeros((n, 3))
    axis, inertial = np.zeros((n, 3)), np.zeros((n, 10))
    # Where each body sits in the link it belongs to: (link, rotation, translation).
    home: dict[int, tuple[int, np.ndarray, np.ndarray]] = {
        0: (-1, np.eye(3), np.zeros(3))
    }
    for body in range(1, model.nbody):
        link, R, p = home[int(model.body_parentid[body])]
        p = p + R @ model.body_pos[body]
        R = R @ _matrix(model.body_quat[body])
        start = model.body_jntadr[body]
        for joint in range(start, start + model.body_jntnum[body]):
            # The file's posture is at the reference position; links count from zero.
            direction, offset = model.jnt_axis[joint], model.jnt_pos[joint]
            reference = model.qpos0[model.jnt_qposadr[joint]]
            anchor = p + R @ offset
            if model.jnt_type[joint] == _HINGE:
                R = R @ rotation_from_axis_angle(direction, -reference)
            else:
                anchor = anchor - reference * (R @ direction)
            p = anchor - R @ offset
            if joint in index:
                k = index.index(joint)
                axis[k], rotation[k], translation[k] = direction, R, anchor
                link, R, p = k, np.eye(3), -offset
        home[body] = (link, R, p)
        if link >= 0:
            inertial[link] += _body_inertial(model, body, R, p)
    dofs = model.jnt_dofadr[index]
    return Chain(
        joints=names,
        rotation=rotation,
        translation=translation,
        axis=axis,
        revolute=model.jnt_type[index] == _HINGE,
        inertial=inertial,
        gravity=model.opt.gravity.copy(),
        armature=model.dof_armature[dofs].copy(),
    )


def _body_inertial(model: Any, body: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    center = p + R @ model.body_ipos[body]
    principal = R @ _matrix(model.body_iquat[body])
    inertia = principal @ np.diag(model.body_inertia[body]) @ principal.T
    return inertial_about(model.body_mass[body], center, inertia)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _numeric(model: Any, name: str, index: list[int], path: Path) -> np.ndarray:
    import mujoco

    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if k < 0:
        return np.full(len(index), np.inf)
    values = model.numeric(name).data
    if len(values) != model.njnt:
        raise RobotError(
            f"{path}: custom numeric {name!r} has {len(values)} values, one for each "
            f"of the {model.njnt} joints is needed"
        )
    return np.array(values)[index]


def _torque_limit(model: Any, index: list[int]) -> np.ndarray:
    """The tightest of joint, actuator and control ranges, at the joint."""
    import mujoco

    limit = np.full(model.njnt, np.inf)
    for j in np.flatnonzero(model.jnt_actfrclimited):
        limit[j] = np.abs(model.jnt_actfrcrange[j]).max()
    for a in range(model.nu):
        joint, gear = int(model.actuator_trnid[a, 0]), abs(model.actuator_gear[a, 0])
        if model.actuator_trntype[a] != mujoco.mjtTrn.mjTRN_JOINT:
            continue
        plain = (
            model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        )
        if plain and model.actuator_ctrllimited[a]:  # a motor: force is gain times ctrl
            force = np.abs(model.actuator_gainprm[a, 0] * model.actuator_ctrlrange[a])
            limit[joint] = min(limit[joint], gear * force.max())
        if model.actuator_forcelimited[a]:
            force = np.abs(model.actuator_forcerange[a]).max()
            limit[joint] = min(limit[joint], gear * force)
    limit[limit <= 0] = np.inf
    return limit[index]


def _servo_gains(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping of position servos at the joint; NaN without one.

    A servo pulls back by as much as its control pulls: ``position`` by position,
    ``velocity`` by speed. Both at one joint, as PD control is often put, add up.
    """
    import mujoco

    kp, kd = np.zeros((2, model.njnt))
    for a in range(model.nu):
        gain, (constant, stiffness, damping) = (
            model.actuator_gainprm[a, 0],
            model.actuator_biasprm[a, :3],
        )
        servo = (
            model.actuator_trntype[a] == mujoco.mjtTrn.mjTRN_JOINT
            and model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
            and gain > 0
            and constant == 0
        )
        position = servo and np.isclose(gain, -stiffness)
        velocity = servo and stiffness == 0 and np.isclose(gain, -damping)
        if position or velocity:
            joint, gear = int(model.actuator_trnid[a, 0]), model.actuator_gear[a, 0]
            kp[joint] -= gear**2 * stiffness
            kd[joint] -= gear**2 * damping
    there = kp > 0
    return np.where(there, kp, np.nan), np.where(there, kd, np.nan)
