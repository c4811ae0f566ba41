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
        plain = (
            model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_FIXED
            and model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_NONE
        )
        most = _most_torque(model, a)
        limit[joint] = min(limit[joint], abs(gear) * most)
        if plain and model.actuator_ctrllimited[a]:  # force is gain times control
            force = np.abs(model.actuator_gainprm[a, 0] * model.actuator_ctrlrange[a])
            limit[joint] = min(limit[joint], abs(gear) * force.max())
        if model.actuator_forcelimited[a]:
            force = np.abs(model.actuator_forcerange[a]).max()
            limit[joint] = min(limit[joint], abs(gear) * force)
    limit[limit <= 0] = np.inf
    return limit


def _most_torque(model: Any, a: int) -> float:
    """Stall torque of a DC motor by the voltage of its controller, or inf."""
    if model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_DCMOTOR:
        resistance, constant = model.actuator_gainprm[a, :2]
        voltage = model.actuator_gainprm[a, 7]
        if voltage > 0:
            return float(constant / resistance * voltage)
    return np.inf


def servo_gains(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness and damping of the position servo at each joint; NaN without one.

    A servo's gain equals its feedback of position (``position``) or speed
    (``velocity``), or is that of the controller of a DC motor whose input is a
    position. The gains of all kinds at one joint, a PD controller, are added.
    """
    kp, kd = np.zeros((2, model.njnt))
    for a, joint, gear in motors_of(model):
        if _positions_motor(model, a):
            kp[joint] += gear**2 * model.actuator_gainprm[a, 4]
            kd[joint] += gear**2 * model.actuator_gainprm[a, 6]
            continue
        gain = model.actuator_gainprm[a, 0]
        constant, stiffness, damping = model.actuator_biasprm[a, :3]
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
    has_servo = kp > 0
    return np.where(has_servo, kp, np.nan), np.where(has_servo, kd, np.nan)


def _positions_motor(model: Any, a: int) -> bool:
    """Whether an actuator is a DC motor behind a PD controller of position."""
    return bool(
        model.actuator_gaintype[a] == mujoco.mjtGain.mjGAIN_DCMOTOR
        and model.actuator_ctrlspec[a] == mujoco.mjtCtrlInput.mjINPUT_POS
        and model.actuator_gainprm[a, 5] == 0  # of the integral
    )
