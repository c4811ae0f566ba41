"""What actuators of MuJoCo's model do at the joints of an arm."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

_BALL = 1  # mjtJoint of joints that have no single axis, up to here


def drives_of(model: Any) -> Iterator[tuple[int, int, float]]:
    """Number, joint and gear of each actuator that works on a joint."""
    return (x for x in _on_joints(model) if model.actuator_ctrlnum[x[0]])


def passive_motors(model: Any) -> Iterator[tuple[int, int, float]]:
    """The same of each motor that nothing commands: cogging and friction (LuGre)."""
    return (x for x in _on_joints(model) if not model.actuator_ctrlnum[x[0]])


def _on_joints(model: Any) -> Iterator[tuple[int, int, float]]:
    import mujoco

    at = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
    for a in range(model.nactuator):
        joint = int(model.actuator_trnid[a, 0])
        if int(model.actuator_trntype[a]) in at and model.jnt_type[joint] > _BALL:
            yield a, joint, float(model.actuator_gear[a, 0])


def ripples(model: Any, index: list[int]) -> np.ndarray:
    """Ripples of the joints, shape (R, 4); see :class:`~hybrid.robot.robot.Robot`."""
    found = []
    for a, joint, gear in passive_motors(model):
        size, k, phase = model.actuator_biasprm[a, :3]
        if joint in index and size:
            sine, cosine = -gear * size * np.array([np.cos(phase), np.sin(phase)])
            found.append((index.index(joint), sine, cosine, gear * k))
    return np.array(found).reshape(-1, 4)


def bristles(model: Any, index: list[int]) -> np.ndarray:
    """Friction of passive motors at the joints as they slide (LuGre), shape (B, 4).

    Returns:
        Joint, level [N·m], what is above it at rest [N·m], and the speed that takes
        this off [rad/s].
    """
    found = []
    for a, joint, gear in passive_motors(model):
        level, static, speed = model.actuator_biasprm[a, 3:6]
        if joint in index and model.actuator_dynprm[a, 5] > 0:
            pull = abs(gear)
            above = pull * (static - level)
            found.append((index.index(joint), pull * level, above, speed / pull))
    return np.array(found).reshape(-1, 4)


def with_drives(model: Any, name: str, drives: list[Any]) -> np.ndarray:
    """Armature or damping of each dof, with that of actuators behind their gears."""
    values = getattr(model, f"dof_{name}").copy()
    for a, joint, gear in drives:
        own = getattr(model, f"actuator_{name}")[a]
        values[model.jnt_dofadr[joint]] += gear**2 * own
    return np.asarray(values)


def torque_limit(model: Any, drives: list[Any]) -> np.ndarray:
    """The tightest of joint, actuator and control ranges, at each joint."""
    import mujoco

    limit = np.full(model.njnt, np.inf)
    for j in np.flatnonzero(model.jnt_actfrclimited):
        limit[j] = np.abs(model.jnt_actfrcrange[j]).max()
    for a, joint, gear in drives:
        plain = (
            model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        )
        if plain and model.actuator_ctrllimited[a]:  # a motor: force is gain times ctrl
            force = np.abs(model.actuator_gainprm[a, 0] * model.actuator_ctrlrange[a])
            limit[joint] = min(limit[joint], abs(gear) * force.max())
        if model.actuator_forcelimited[a]:
            force = np.abs(model.actuator_forcerange[a]).max()
            limit[joint] = min(limit[joint], abs(gear) * force)
    limit[limit <= 0] = np.inf
    return limit


def servo_gains(model: Any, drives: list[Any]) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping of position servos at the joint; NaN without one.

    A servo pulls back by as much as its control pulls: ``position`` by position,
    ``velocity`` by speed. Both at one joint, as PD control is often put, add up.
    """
    import mujoco

    kp, kd = np.zeros((2, model.njnt))
    for a, joint, gear in drives:
        gain, (constant, stiffness, damping) = (
            model.actuator_gainprm[a, 0],
            model.actuator_biasprm[a, :3],
        )
        servo = (
            model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
            and gain > 0
            and constant == 0
        )
        position = servo and np.isclose(gain, -stiffness)
        velocity = servo and stiffness == 0 and np.isclose(gain, -damping)
        if position or velocity:
            kp[joint] -= gear**2 * stiffness
            kd[joint] -= gear**2 * damping
    there = kp > 0
    return np.where(there, kp, np.nan), np.where(there, kd, np.nan)
