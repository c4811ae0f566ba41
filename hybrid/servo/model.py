"""The MuJoCo model of an arm with servos: DC motors behind position controllers."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array, Index, Mask
from hybrid.dynamics.kinematics import frames
from hybrid.effects.backlash import Backlash, set_play
from hybrid.robot import Robot
from hybrid.servo.drive import Drive, centres
from hybrid.servo.stretch import Stretch

# N·m/A and Ω: the constant is so small that speed does not reduce the stall torque.
_CONSTANT, _RESISTANCE = 1e-3, 1.0
_SOFT = 1e-6  # N·m/rad: a spring whose torque does not change with position
_BELOW = 1e-3  # m: smallest radius of the ball about a centre of mass
_CREEPS = 0.05  # rad/s: static friction holds slower joints


def file_step(robot: Robot) -> float:
    """Time step of the file, or the default of MuJoCo, [s]."""
    return float(robot.timestep) if np.isfinite(robot.timestep) else 0.002


def servo_spec(robot: Robot, drive: Drive) -> mujoco.MjSpec:
    """An arm with a DC motor behind a position controller at every joint.

    It has the zeros, signs and tilt of a drive. Behind a motor with play is another
    joint, see :class:`hybrid.effects.backlash.Backlash`.
    """
    spec = robot.mujoco_spec()
    drive.tilt.edit_spec(spec, robot.joints)
    for j, joint in enumerate(robot.joints):
        own = spec.joint(joint)
        own.ref, own.axis = -drive["zero"][j], drive["sign"][j] * np.array(own.axis)
        own.limited, own.range = True, np.array([-1.0, 1.0])
        # Placeholders: :func:`install` sets the values in the compiled model.
        _actuator(spec, joint).set_to_dcmotor(
            motorconst=[_CONSTANT, _CONSTANT],
            resistance=_RESISTANCE,
            controller=[1.0, 0, 0, 0, 0, 0],
            saturation=[1.0, 0, 0],
            lugre=[1.0, 1.0, 1.0, 1.0, 1.0],
            ctrlspec=int(mujoco.mjtCtrlInput.mjINPUT_POS),
        )
    for j in np.flatnonzero(drive.plays).tolist():
        own = spec.joint(robot.joints[j])
        own.armature = max(own.armature, 1.0)
        Backlash((j,), {"half_width": 1.0}).edit_spec(spec, robot.joints)
    return spec


def places(plays: Mask) -> tuple[Index, Index]:
    """Indices in a compiled model: of all motor joints, and of joints for play."""
    behind = np.cumsum(plays)
    own = np.arange(len(plays)) + behind - plays
    return own, own[plays] + 1


def declared_spec(robot: Robot) -> mujoco.MjSpec:
    """An arm with the position servos of its file, or usual ones."""
    spec, drive = robot.mujoco_spec(), Drive.declared(robot)
    servo = np.where(np.isfinite(robot.kd), robot.kd, 0.0)
    for j, joint in enumerate(robot.joints):
        actuator, most = _actuator(spec, joint), drive["stall"][j]
        actuator.set_to_position(kp=drive["stiffness"][j], kv=servo[j])
        actuator.forcerange, actuator.forcelimited = [-most, most], True
        own = spec.joint(joint)
        own.limited, own.range = True, np.array([drive["lower"][j], drive["upper"][j]])
    return spec


def _actuator(spec: Any, joint: str) -> Any:
    kind = mujoco.mjtTrn.mjTRN_JOINT
    return spec.add_actuator(name=joint, trntype=kind, target=joint)


def lay_ground(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add a ground plane below the reach of the arm, and a ball to each link.

    The ball is about the centre of mass. Its radius is the height of the centre above
    the plane when the link touches the real ground: see :func:`install`. An arm without
    gravity gets none.
    """
    if not robot.chain.gravity.any():
        return
    up, kind = _up(robot), mujoco.mjtGeom
    turn = Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])[0]
    how: dict[str, Any] = {"condim": 1, "contype": 0, "conaffinity": 1}
    quat = turn.as_quat(scalar_first=True)
    plane = {"type": kind.mjGEOM_PLANE, "pos": _level(robot) * up, "quat": quat}
    spec.worldbody.add_geom(size=[1.0, 1.0, 1.0], **plane, **how)
    how |= {"contype": 1, "conaffinity": 0, "mass": 0.0, "type": kind.mjGEOM_SPHERE}
    for joint, centre in zip(robot.joints, centres(robot), strict=True):
        spec.body(joint).add_geom(pos=centre, size=[_BELOW, 0.0, 0.0], **how)


def _up(robot: Robot) -> Array:
    gravity = robot.chain.gravity
    return np.asarray(-gravity / max(float(np.linalg.norm(gravity)), 1e-12))


def _level(robot: Robot) -> float:
    """Height of the ground, [m]."""
    return float(Drive.declared(robot)["ground"].min()) - _BELOW


def heights(robot: Robot, q: Array) -> Array:
    """Heights of the centres of mass above the base, shape (N, n), [m]."""
    R, origin, _ = frames(robot.chain, q)
    centre = origin + np.einsum("kNij,kj->kNi", R, centres(robot))
    return np.asarray((centre @ _up(robot)).T)


def install(model: Any, robot: Robot, drive: Drive, data: Any) -> None:
    """Set the servo parameters in a compiled model with a dcmotor at every joint.

    ``data`` is that of a model with the same joints; its state is lost.
    """
    for name, x in motors(robot, drive).items():
        getattr(model, f"actuator_{name}")[:, : x.shape[1]] = x
    model.actuator_forcelimited[:] = 0
    model.actuator_ctrllimited[:] = 0
    own, behind = places(plays := drive.plays)
    model.dof_frictionloss[:] = 0.0
    model.dof_damping[own] = dampings(robot, drive)[1]
    model.dof_dampingpoly[own, 0] = drive["quadratic"]
    model.dof_armature[own] = drive["armature"]
    model.jnt_stiffness[own], model.qpos_spring[own] = springs(robot, drive)
    model.jnt_range[own] = stops(drive)
    set_play(model, behind, drive["play"][plays], drive["armature"][plays])
    balls = np.maximum(drive["ground"] - _level(robot), _BELOW)
    if model.ngeom:
        model.geom_size[1:, 0] = model.geom_rbound[1:] = balls
    if (drive["mass"] != 1.0).any():
        model.body_mass[1:] *= drive["mass"]
        model.body_inertia[1:] *= drive["mass"][:, None]
        mujoco.mj_setConst(model, data)


def motors(robot: Robot, drive: Drive) -> dict[str, Array]:
    """Parameters of MuJoCo's DC motors with position controllers, (n, ·) each."""
    gain, bias, dyn = (np.zeros((robot.size, k)) for k in (8, 6, 7))
    gain[:, 0], gain[:, 1], gain[:, 4] = _RESISTANCE, _CONSTANT, drive["stiffness"]
    gain[:, 6], gain[:, 7] = dampings(robot, drive)[0], drive["stall"] / _CONSTANT
    bias[:, 3], bias[:, 5] = drive["coulomb"], drive["stribeck_speed"]
    bias[:, 4] = drive["coulomb"] + drive["stiction"]
    # With this damping the rotor on its bristles comes to rest.
    dyn[:, 5], dyn[:, 6] = drive.bristle, np.sqrt(drive.bristle * drive["armature"])
    return {"gainprm": gain, "biasprm": bias, "dynprm": dyn}


def dampings(robot: Robot, drive: Drive) -> tuple[Array, Array]:
    """Damping of the servos and of the joints, (n,) each, in the ratio of the file.

    Motion tells them apart only at the torque limit.
    """
    servo = np.nan_to_num(robot.kd)
    share = servo / np.maximum(servo + robot.damping, 1e-12)
    return share * drive["damping"], (1 - share) * drive["damping"]


def stops(drive: Drive) -> Array:
    """Range of every joint in the positions of the log, shape (n, 2), [rad]."""
    return in_log(drive, np.stack([drive["lower"], drive["upper"]]))


def in_log(drive: Drive, ends: Array) -> Array:
    """Ranges in positions of the file, (2, n), as positions of the log, (n, 2)."""
    return np.asarray((np.sort(ends * drive["sign"], axis=0) - drive["zero"]).T)


def springs(robot: Robot, drive: Drive) -> tuple[Array, Array]:
    """Stiffness [N·m/rad] and relaxed position [rad] of every joint's spring, (n,).

    A torque offset is a very soft spring with a distant relaxed position, or shifts
    that of the spring in the file.
    """
    stiffness = np.maximum(robot.stiffness, _SOFT) + drive["spring"]
    relaxed = drive["sign"] * robot.springref - drive["zero"]
    return stiffness, relaxed + drive["offset"] / stiffness


def bristles(drive: Drive, stretch: Stretch, first: Array, weight: Array) -> Array:
    """Bend of the bristles at the first sample, shape (n,), [rad].

    A slow joint is at rest: friction balances the servo and the ``weight``, shape (n,),
    [N·m], less the pull of springs and offset. A fast one slides.
    """
    off = first - stretch.q[0]
    pull = drive["stiffness"] * (
        off - np.clip(off, -drive["dead_band"], drive["dead_band"])
    )
    rest = np.clip(pull, -drive["stall"], drive["stall"]) - weight
    level = drive["coulomb"] + drive["load_friction"] * np.abs(weight)
    most = level + drive["stiction"]
    sliding = np.sign(stretch.v) * level
    held = np.clip(rest, -most, most)
    bristle = level / drive["presliding"]
    return np.where(np.abs(stretch.v) > _CREEPS, sliding, held) / bristle
