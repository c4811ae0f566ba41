"""Read the actuators of a MuJoCo model: drives, servos, ripple and friction."""

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

_BALL = 1  # mjtJoint; joints of higher types have one axis


def motors_of(model: Any, *, driven: bool = True) -> Iterator[tuple[int, int, float]]:
    """Number, joint and gear of each actuator at a joint.

    They are the drives, which have a control input; or not ``driven``: motors without
    one model cogging and friction (LuGre).
    """
    at = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
    for a in range(model.nactuator):
        joint = int(model.actuator_trnid[a, 0])
        if (
            int(model.actuator_trntype[a]) in at
            and model.jnt_type[joint] > _BALL
            and bool(model.actuator_ctrlnum[a]) == driven
        ):
            yield a, joint, float(model.actuator_gear[a, 0])


def ripples(model: Any, index: list[int]) -> np.ndarray:
    """Ripples, shape (R, 4), as in :class:`~hybrid.robot.robot.Robot`."""
    found = []
    for a, joint, gear in motors_of(model, driven=False):
        size, k, phase = model.actuator_biasprm[a, :3]
        if joint in index and size:
            sine, cosine = -gear * size * np.array([np.cos(phase), np.sin(phase)])
            found.append((index.index(joint), sine, cosine, gear * k))
    return np.array(found).reshape(-1, 4)


def bristles(model: Any, index: list[int], *, driven: bool = False) -> np.ndarray:
    """LuGre friction of motors, of drives or else of passive ones, shape (S, 5).

    Columns are those of :attr:`.Robot.bristle`.
    """
    found = []
    for a, joint, gear in motors_of(model, driven=driven):
        if model.actuator_biastype[a] != mujoco.mjtBias.mjBIAS_DCMOTOR:
            continue
        level, static, speed = model.actuator_biasprm[a, 3:6]
        stiffness, ratio = model.actuator_dynprm[a, 5], abs(gear)
        if joint in index and stiffness > 0:
            at_joint = ratio * level, ratio * (static - level), speed / ratio
            bend = level / stiffness / ratio
            found.append((index.index(joint), *at_joint, bend))
    return np.array(found).reshape(-1, 5)


def latency(model: Any) -> np.ndarray:
    """Largest delay of a control input at each joint, [s]."""
    late = np.zeros(model.njnt)
    for a, joint, _ in motors_of(model):
        late[joint] = max(late[joint], model.actuator_delay[a])
    return late


def through_gears(model: Any, name: str) -> np.ndarray:
    """Armature or damping of the actuators at each dof, shape (nv,)."""
    values = np.zeros(model.nv)
    for a, joint, gear in motors_of(model):
        own = getattr(model, f"actuator_{name}")[a]
        values[model.jnt_dofadr[joint]] += gear**2 * own
    return values


def torque_limit(model: Any) -> np.ndarray:
    """Smallest torque limit at each joint: of joint, actuator and control range."""
    limit = np.full(model.njnt, np.inf)
    for j in np.flatnonzero(model.jnt_actfrclimited):
        limit[j] = np.abs(model.jnt_actfrcrange[j]).max()
    for a, joint, gear in motors_of(model):
        kind, gain = model.actuator_gaintype[a], model.actuator_gainprm[a]
        plain = (
            kind == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        )
        most = np.inf
        if kind == mujoco.mjtGain.mjGAIN_DCMOTOR and gain[7] > 0:
            most = gain[1] / gain[0] * gain[7]  # stall torque at the largest voltage
        if plain and model.actuator_ctrllimited[a]:  # force is gain times control
            most = min(most, np.abs(gain[0] * model.actuator_ctrlrange[a]).max())
        if model.actuator_forcelimited[a]:
            most = min(most, np.abs(model.actuator_forcerange[a]).max())
        limit[joint] = min(limit[joint], abs(gear) * most)
    limit[limit <= 0] = np.inf
    return limit


def servo_gains(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping of the position servo at each joint; NaN without one.

    A servo's gain equals its feedback of position (``position``) or speed
    (``velocity``), or is that of the controller of a DC motor whose input is a
    position. The gains of all kinds at one joint, a PD controller, are added.
    """
    kp, kd = np.zeros((2, model.njnt))
    for a, joint, gear in motors_of(model):
        kind, gain = model.actuator_gaintype[a], model.actuator_gainprm[a]
        constant, stiffness, damping = model.actuator_biasprm[a, :3]
        if kind == mujoco.mjtGain.mjGAIN_DCMOTOR:
            position = model.actuator_ctrlspec[a] == mujoco.mjtCtrlInput.mjINPUT_POS
            servo = position and gain[5] == 0  # of the integral
            stiffness, damping = -gain[4], -gain[6]
        else:
            servo = (
                kind == mujoco.mjtGain.mjGAIN_FIXED
                and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_AFFINE
                and gain[0] > 0
                and constant == 0
                and np.isclose(gain[0], -stiffness if stiffness else -damping)
            )
        if servo:
            kp[joint] -= gear**2 * stiffness
            kd[joint] -= gear**2 * damping
    has_servo = kp > 0
    return np.where(has_servo, kp, np.nan), np.where(has_servo, kd, np.nan)
