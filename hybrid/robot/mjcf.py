"""Read chain and declared properties of an arm from a MuJoCo model.

MuJoCo itself compiles the file, so that defaults, includes, angle units and inertias
from geometry are exactly those of MuJoCo.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.errors import RobotError, warn
from hybrid.robot.actuators import (
    bristles,
    latency,
    ripples,
    servo_gains,
    through_gears,
    torque_limit,
)
from hybrid.robot.tree import Node, Tree, serial_joints

_FREE, _BALL, _SLIDE, _HINGE = range(4)  # mjtJoint
_KINDS = {_FREE: "is free", _BALL: "is a ball"}


def fields_of_mujoco(
    model: Any,
    where: str,
    joints: tuple[str, ...] | None,
    held: Mapping[str, float],
    missing_inertia: Mapping[int, str],
) -> dict[str, Any]:
    """Read the fields of a :class:`~hybrid.robot.robot.Robot` from a MuJoCo model.

    MJCF has no velocity and acceleration limits. They are read from the custom numerics
    ``velocity_limit`` and ``acceleration_limit``, with one value per joint.
    """
    tree = mujoco_tree(model, where)
    keep = serial_joints(tree, joints, held)
    index = joint_numbers(model, keep)
    low, high = model.jnt_range[index].T
    limited = model.jnt_limited[index].astype(bool)
    kp, kd = servo_gains(model)
    places, _ = tree.places(keep, held)
    moved = [n.body for n, p in places if p.link >= 0 and n.body is not None]
    for body in moved:
        if body in missing_inertia:
            raise RobotError(
                f"link {model.body(body).name or body!r} has no inertia of its own, "
                f"and its mesh {missing_inertia[body]!r} is missing; add the mesh or "
                "an <inertial>"
            )
    gravity = _gravity(model, index, moved)
    armature = model.dof_armature + through_gears(model, "armature")
    falling = bristles(model, index)[:, [0, 2, 3]]
    return {
        "name": model.names[: model.names.index(b"\0")].decode(),
        "chain": tree.chain(keep, held, gravity, armature[model.jnt_dofadr[index]]),
        "held": dict(held),
        "q_min": np.where(limited, low, -np.inf),
        "q_max": np.where(limited, high, np.inf),
        "v_max": _numeric(model, "velocity_limit", index, where),
        "a_max": _numeric(model, "acceleration_limit", index, where),
        "tau_max": torque_limit(model)[index],
        "kp": kp[index],
        "kd": kd[index],
        "timestep": float(model.opt.timestep),
        **_passive(model, index),
        "ripple": ripples(model, index),
        "falling": falling[(falling[:, 1:] > 0).all(axis=1)],
        "coupled": _coupled(model, index),
        "bristle": bristles(model, index, driven=True),
        "stiffening": _stiffening(model, index),
        "latency": latency(model)[index],
    }


def joint_names(model: Any) -> list[str]:
    """Names of the joints; a joint without a name gets its number."""
    return [model.joint(j).name or f"joint_{j + 1}" for j in range(model.njnt)]


def joint_numbers(model: Any, joints: Iterable[str]) -> list[int]:
    """Numbers of joints in the model."""
    names = joint_names(model)
    return [names.index(name) for name in joints]


def _passive(model: Any, index: list[int]) -> dict[str, Any]:
    """Friction and springs of the joints."""
    dofs = model.jnt_dofadr[index]
    damping = model.dof_damping + through_gears(model, "damping")
    damper, spring, dry = (
        _enabled(model, name) for name in ("DAMPER", "SPRING", "FRICTIONLOSS")
    )
    quadratic, cubic = damper * model.dof_dampingpoly[dofs].T
    level, slope = dry * model.dof_frictionloss[dofs], knee_slope(model)[dofs]
    soft = (level > 0) & np.isfinite(slope)
    other = np.zeros(len(index))  # dry friction of tendons and passive motors
    for t, own, ratio in sum_tendons(model):
        if len(own) == 1 and own[0] in index:
            other[index.index(own[0])] += dry * ratio * model.tendon_frictionloss[t]
    for j, sliding, *_ in bristles(model, index):
        other[int(j)] += sliding
    return {
        "damping": damper * damping[dofs],
        "quadratic": quadratic,
        "cubic": cubic,
        "frictionloss": np.where(soft, 0.0, level) + other,
        "knee": np.where(soft, level, 0.0),
        "knee_speed": np.where(soft, level / slope, 0.0),
        "stiffness": spring * model.jnt_stiffness[index],
        "springref": model.qpos_spring[model.jnt_qposadr[index]].copy(),
    }


def knee_slope(model: Any) -> np.ndarray:
    """Slope of each dof's friction below its level, [N·m·s/rad]; inf if it is dry.

    MuJoCo softens all dry friction. The slope is finite only if ``solreffriction`` has
    stiffness 0 and a damping, which the writer of this package uses for it.
    """
    stiffness, damping = model.dof_solref.T
    softness = (1.0 - model.dof_solimp[:, 0]) * model.dof_invweight0
    has_slope = (stiffness <= 0) & (damping < 0) & (softness > 0)
    return np.where(has_slope, -damping / np.where(has_slope, softness, 1.0), np.inf)


def sum_tendons(model: Any) -> Iterator[tuple[int, list[int], float]]:
    """Tendons as long as a multiple of the sum of one or two joints' positions.

    Yields:
        Number, joints, and torque at each joint per force, which is the multiple.
    """
    for t in np.flatnonzero(model.tendon_num <= 2).tolist():
        own = slice(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
        fixed = (model.wrap_type[own] == mujoco.mjtWrap.mjWRAP_JOINT).all()
        if fixed and np.ptp(model.wrap_prm[own]) == 0:
            ratio = abs(float(model.wrap_prm[own][0]))
            yield t, model.wrap_objid[own].tolist(), ratio


def _stiffening(model: Any, index: list[int]) -> np.ndarray:
    """Stiffening springs, see :class:`Robot`, from tendons on a joint, shape (K, 4)."""
    rows = []
    for t, own, _ in sum_tendons(model) if _enabled(model, "SPRING") else ():
        linear, (low, high) = model.tendon_stiffness[t], model.tendon_lengthspring[t]
        quadratic, cubic = model.tendon_stiffnesspoly[t]
        stiffens = linear > 0 and quadratic == 0 and cubic > 0 and low == high
        if stiffens and len(own) == 1 and own[0] in index:
            ratio = float(model.wrap_prm[model.tendon_adr[t]])  # may be negative
            knee = np.sqrt(linear / cubic) / abs(ratio)
            rows.append((index.index(own[0]), linear * ratio**2, low / ratio, knee))
    return np.array(rows).reshape(-1, 4)


def _coupled(model: Any, index: list[int]) -> np.ndarray:
    """Rotors that turn with the sum of two joints, see :class:`Robot`, shape (C, 5)."""
    damper, dry = (_enabled(model, name) for name in ("DAMPER", "FRICTIONLOSS"))
    found: dict[tuple[int, ...], np.ndarray] = {}
    for t, own, ratio in sum_tendons(model):
        if len(own) == 2 and {*own} <= {*index}:
            pair = tuple(sorted(index.index(j) for j in own))
            inertia, damping = model.tendon_armature[t], model.tendon_damping[t]
            friction = dry * model.tendon_frictionloss[t]
            forces = np.array([ratio * inertia, ratio * damper * damping, friction])
            found[pair] = found.get(pair, 0.0) + ratio * forces
    rows = [(*pair, *forces) for pair, forces in found.items() if forces.any()]
    return np.array(rows).reshape(-1, 5)


def _enabled(model: Any, flag: str) -> float:
    """One, or zero if an option of the file disables a kind of force."""
    off = int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag}"))
    return 0.0 if model.opt.disableflags & off else 1.0


def mujoco_tree(model: Any, where: str | Path) -> Tree:
    """Tree of the bodies of a MuJoCo model, each after its joints."""
    names, nodes = joint_names(model), [Node(-1, body=0, name="world")]
    last = {0: 0}  # frame of each body
    for body in range(1, model.nbody):
        parent = last[int(model.body_parentid[body])]
        R, p = matrix(model.body_quat[body]), model.body_pos[body]
        for joint in np.flatnonzero(model.jnt_bodyid == body).tolist():
            kind, offset = int(model.jnt_type[joint]), np.zeros(3)
            own: dict[str, Any] = {"kind": _KINDS.get(kind, "")}
            if kind not in _KINDS:
                R, p, offset = joint_frame(model, joint, R, p)
                own["axis"], own["revolute"] = model.jnt_axis[joint], kind == _HINGE
                own["home"] = float(model.qpos0[model.jnt_qposadr[joint]])
            nodes.append(Node(parent, R, p, joint=names[joint], **own))
            parent, R, p = len(nodes) - 1, np.eye(3), -offset
        principal = matrix(model.body_iquat[body])
        node = Node(
            parent, R, p, body=body,
            name=model.body(body).name or repr(body),
            mass=float(model.body_mass[body]),
            center=model.body_ipos[body],
            inertia=principal @ np.diag(model.body_inertia[body]) @ principal.T,
        )  # fmt: skip
        last[body] = len(nodes)
        nodes.append(node)
    return Tree(str(where), nodes)


def joint_frame(
    model: Any, joint: int, R: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frame of a hinge or slide at position zero, and its offset in the body, [m].

    The body has rotation R and position p, [m], at the joint's position in the file.
    """
    axis, offset = model.jnt_axis[joint], model.jnt_pos[joint]
    back = -model.qpos0[model.jnt_qposadr[joint]]
    p = p + R @ offset
    if model.jnt_type[joint] == _HINGE:
        return R @ Rotation.from_rotvec(back * axis).as_matrix(), p, offset
    return R, p + back * (R @ axis), offset


def _gravity(model: Any, index: list[int], moved: list[int]) -> np.ndarray:
    """Gravity that drives carry, less a uniform gravity compensation of the file."""
    gravity = _enabled(model, "GRAVITY") * model.opt.gravity
    share = model.body_gravcomp[[b for b in moved if model.body_mass[b] > 0]]
    by_drives = model.jnt_actgravcomp[index].all()
    if not share.any() or by_drives or np.ptp(share) > 0:
        return np.asarray(gravity)
    warn(
        f"gravcomp of the file takes {share[0]:.0%} of the links' weight off the "
        "drives; if the torque of a log carries it, take gravcomp out"
    )
    return np.asarray((1.0 - share[0]) * gravity)


def matrix(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrix of a quaternion with the scalar first, shape (3, 3)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def _numeric(model: Any, name: str, index: list[int], where: str) -> np.ndarray:
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
