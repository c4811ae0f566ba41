"""MuJoCo's model of a file -> chain and declared properties.

Compiling with MuJoCo, rather than parsing the XML a second way, keeps defaults,
includes, angle units and geometry-derived inertias exactly as MuJoCo sees them.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot.actuators import (
    drives_of,
    ripples,
    servo_gains,
    torque_limit,
    with_drives,
)
from hybrid.robot.chain import Chain
from hybrid.robot.selection import Tree, serial_joints
from hybrid.robot.spatial import (
    inertia_fault,
    inertial_about,
    rotation_from_axis_angle,
)

_FREE, _BALL, _SLIDE, _HINGE = range(4)  # mjtJoint; mujoco is imported only when used
_KINDS = {_FREE: "is free", _BALL: "is a ball"}


def fields_of_mujoco(
    model: Any,
    where: str,
    joints: tuple[str, ...] | None,
    held: Mapping[str, float],
    wanting: Mapping[int, str],
) -> dict[str, Any]:
    """Fields of a :class:`~hybrid.robot.robot.Robot` read from MuJoCo's model.

    Velocity and acceleration limits, which MJCF has no place for, are read from the
    custom numerics ``velocity_limit`` and ``acceleration_limit`` (one value a joint).

    Args:
        model: MuJoCo's model.
        where: The file or object, for messages.
        joints: Joints to keep, or None for the arm that the tree holds.
        held: Positions of other joints, [rad or m].
        wanting: The missing file that each body's inertia would come from.

    Raises:
        RobotError: There is no serial arm, or the inertia of a link is missing.
    """
    names = joint_names(model)
    parents = {name: _parent(model, j, names) for j, name in enumerate(names)}
    kinds = {
        name: _KINDS[kind]
        for name, kind in zip(names, model.jnt_type.tolist(), strict=True)
        if kind in _KINDS
    }
    keep = serial_joints(Tree(where, parents, kinds), joints, held)
    index = [names.index(name) for name in keep]
    low, high = model.jnt_range[index].T
    limited = model.jnt_limited[index].astype(bool)
    drives = list(drives_of(model))
    kp, kd = servo_gains(model, drives)
    return {
        "chain": _chain(model, index, names, held, wanting, drives),
        "held": dict(held),
        "q_min": np.where(limited, low, -np.inf),
        "q_max": np.where(limited, high, np.inf),
        "v_max": _numeric(model, "velocity_limit", index, where),
        "a_max": _numeric(model, "acceleration_limit", index, where),
        "tau_max": torque_limit(model, drives)[index],
        "kp": kp[index],
        "kd": kd[index],
        "timestep": float(model.opt.timestep),
        **_passive(model, index, drives),
        "ripple": ripples(model, index),
    }


def joint_names(model: Any) -> list[str]:
    """Names of the joints; those without one are numbered."""
    return [model.joint(j).name or f"joint_{j + 1}" for j in range(model.njnt)]


def start(model: Any, held: Mapping[str, float]) -> np.ndarray:
    """Position of the whole model with some joints held elsewhere, shape (nq,)."""
    q, names = model.qpos0.copy(), joint_names(model)
    for name, position in held.items():
        q[model.jnt_qposadr[names.index(name)]] = position
    return np.asarray(q)


def _passive(model: Any, index: list[int], drives: list[Any]) -> dict[str, Any]:
    """Friction and springs of the joints."""
    dofs = model.jnt_dofadr[index]
    damping = with_drives(model, "damping", drives)
    damper, spring, dry = (
        _on(model, name) for name in ("DAMPER", "SPRING", "FRICTIONLOSS")
    )
    quadratic, cubic = damper * model.dof_dampingpoly[dofs].T
    level, slope = dry * model.dof_frictionloss[dofs], knee_slope(model)[dofs]
    soft = (level > 0) & np.isfinite(slope)
    beside = np.zeros(model.nv)
    for t, dof, pull in single_tendons(model):
        beside[dof] += dry * pull * model.tendon_frictionloss[t]
    return {
        "damping": damper * damping[dofs],
        "quadratic": quadratic,
        "cubic": cubic,
        "frictionloss": np.where(soft, 0.0, level) + beside[dofs],
        "knee": np.where(soft, level, 0.0),
        "knee_speed": np.where(soft, level / slope, 0.0),
        "stiffness": spring * model.jnt_stiffness[index],
        "springref": model.qpos_spring[model.jnt_qposadr[index]].copy(),
    }


def knee_slope(model: Any) -> np.ndarray:
    """Friction of each dof per speed up to its level, [N·m·s/rad]; inf if it is dry.

    MuJoCo softens all dry friction by numbers that say how nearly a constraint holds.
    A ``solreffriction`` of stiffness 0 and a damping is meant: it is this slope.
    """
    stiffness, damping = model.dof_solref.T
    loose = (1.0 - model.dof_solimp[:, 0]) * model.dof_invweight0
    said = (stiffness <= 0) & (damping < 0) & (loose > 0)
    return np.where(said, -damping / np.where(said, loose, 1.0), np.inf)


def single_tendons(model: Any) -> Iterator[tuple[int, int, float]]:
    """Number, dof and torque per force of each tendon that is on one joint only."""
    import mujoco

    for t in np.flatnonzero(model.tendon_num == 1).tolist():
        at = int(model.tendon_adr[t])
        if model.wrap_type[at] == mujoco.mjtWrap.mjWRAP_JOINT:
            dof = int(model.jnt_dofadr[model.wrap_objid[at]])
            yield t, dof, abs(float(model.wrap_prm[at]))


def _on(model: Any, flag: str) -> float:
    """One, or zero where the file's option switches a kind of force off."""
    import mujoco

    off = int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
    return 0.0 if model.opt.disableflags & off else 1.0


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


def _chain(
    model: Any,
    index: list[int],
    names: list[str],
    held: Mapping[str, float],
    wanting: Mapping[int, str],
    drives: list[Any],
) -> Chain:
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
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            if model.jnt_type[joint] not in (_HINGE, _SLIDE):
                continue
            at = 0.0 if joint in index else held.get(names[joint])
            R, p = moved_to(model, joint, R, p, at)
            if joint in index:
                link, offset = index.index(joint), model.jnt_pos[joint]
                axis[link] = model.jnt_axis[joint]
                rotation[link], translation[link] = R, p + R @ offset
                R, p = np.eye(3), -offset
        home[body] = (link, R, p)
        if link >= 0:
            if body in wanting:
                raise RobotError(
                    f"link {model.body(body).name or body!r} has no inertia of its "
                    f"own, and its mesh {wanting[body]!r} is missing; add the mesh or "
                    "an <inertial>"
                )
            inertial[link] += _body_inertial(model, body, R, p)
    moved = [body for body, (link, _, _) in home.items() if link >= 0]
    return Chain(
        joints=tuple(names[j] for j in index),
        rotation=rotation,
        translation=translation,
        axis=axis,
        revolute=model.jnt_type[index] == _HINGE,
        inertial=inertial,
        gravity=_gravity(model, index, moved),
        armature=with_drives(model, "armature", drives)[model.jnt_dofadr[index]],
    )


def moved_to(
    model: Any, joint: int, R: np.ndarray, p: np.ndarray, at: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a body when a joint is at a position, of the pose at its reference.

    The file has its posture there; links count from zero.
    """
    if at is None:
        return R, p
    direction, offset = model.jnt_axis[joint], model.jnt_pos[joint]
    far = at - model.qpos0[model.jnt_qposadr[joint]]
    anchor = p + R @ offset
    if model.jnt_type[joint] == _HINGE:
        R = R @ rotation_from_axis_angle(direction, far)
    else:
        anchor = anchor + far * (R @ direction)
    return R, anchor - R @ offset


def _gravity(model: Any, index: list[int], moved: list[int]) -> np.ndarray:
    """Gravity as drives carry it, less what the file takes off all links alike."""
    gravity = _on(model, "GRAVITY") * model.opt.gravity
    relief = model.body_gravcomp[[b for b in moved if model.body_mass[b] > 0]]
    by_drives = model.jnt_actgravcomp[index].all()
    if not relief.any() or by_drives or np.ptp(relief) > 0:
        return np.asarray(gravity)
    warnings.warn(
        f"gravcomp of the file takes {relief[0]:.0%} of the links' weight off the "
        "drives; if the torque of a log carries it, take gravcomp out",
        HybridWarning,
        stacklevel=6,
    )
    return np.asarray((1.0 - relief[0]) * gravity)


def _body_inertial(model: Any, body: int, R: np.ndarray, p: np.ndarray) -> np.ndarray:
    fault = inertia_fault(model.body_mass[body], np.diag(model.body_inertia[body]))
    if fault:
        raise RobotError(f"link {model.body(body).name or body!r} {fault}")
    center = p + R @ model.body_ipos[body]
    principal = R @ _matrix(model.body_iquat[body])
    inertia = principal @ np.diag(model.body_inertia[body]) @ principal.T
    return inertial_about(model.body_mass[body], center, inertia)


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _numeric(model: Any, name: str, index: list[int], where: str) -> np.ndarray:
    import mujoco

    k = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, name)
    if k < 0:
        return np.full(len(index), np.inf)
    values = model.numeric(name).data
    if len(values) != model.njnt:
        raise RobotError(
            f"{where}: custom numeric {name!r} has {len(values)} values, one for each "
            f"of the {model.njnt} joints is needed"
        )
    return np.array(values)[index]
