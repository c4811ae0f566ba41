"""Effects in the terms of MJCF: joints, actuators, tendons, and what has no place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.diagnose.gap import Gap
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.effect import Port
from hybrid.plant.arm import drives, overrides
from hybrid.robot import Robot

if TYPE_CHECKING:
    import mujoco

# Values of MuJoCo's mjtIntegrator, mjtTrn, mjtBias and mjtDyn.
_IMPLICITFAST, _AT_JOINT, _AFFINE, _FIRST_ORDER = 3, 0, 1, 3
_STEP = 0.001  # s
# By default MuJoCo's dry friction is so soft that it is viscous at low speed.
_IMPEDANCE = 0.9999
_MOST_MISSED = 0.7  # of the torque of a law that friction stands in for
_CLIPS = 0.9  # loss beyond the limit from which a drive clips


def express(
    gap: Gap, robot: Robot, effects: Sequence[Effect]
) -> tuple[mujoco.MjSpec, tuple[str, ...]]:
    """A MuJoCo spec of an arm with effects, one motor at each joint.

    Args:
        gap: Motions along which dry and viscous friction should stand in for laws that
            MJCF does not have.
        robot: The arm.
        effects: Effects on it.

    Returns:
        The spec, and what it has only nearly or not at all.
    """
    spec = robot.mujoco_spec()
    spec.option.timestep = _STEP
    spec.option.integrator = _IMPLICITFAST
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)
        joint.solref_friction[0] = 2 * _STEP
        joint.solimp_friction[:2] = _IMPEDANCE
        if np.isfinite([robot.q_min[k], robot.q_max[k]]).all():
            joint.limited, joint.range = (
                True,
                np.array([robot.q_min[k], robot.q_max[k]]),
            )
        motor = spec.add_actuator(name=name, target=name)
        motor.trntype = _AT_JOINT
        if np.isfinite(robot.tau_max[k]):
            motor.forcelimited = True
            motor.forcerange = np.array([-1.0, 1.0]) * robot.tau_max[k]
    for name, limit in (("velocity", robot.v_max), ("acceleration", robot.a_max)):
        if np.isfinite(limit).all():
            spec.add_numeric(name=f"{name}_limit", size=robot.size).data = limit
    notes = []
    for effect in sorted(effects, key=lambda e: list(Port).index(e.port)):
        where = f"{effect.id} of {', '.join(robot.joints[j] for j in effect.joints)}"
        if overrides(effect, "edit_spec"):
            effect.edit_spec(spec, robot.joints)
        elif len(effect.joints) > 1 or not _exact(spec, robot, effect):
            instead = _as_friction(spec, gap, robot, effect)
            notes.append(f"{where}{f', {instead}' if instead else ''}")
    return spec, (*notes, *_without_sense(spec, robot))


def _exact(spec: mujoco.MjSpec, robot: Robot, effect: Effect) -> bool:
    """Put in an effect of one joint that MJCF has; whether it does."""
    name, value = robot.joints[effect.joints[0]], effect.values
    joint, motor = spec.joint(name), spec.actuator(name)
    match effect.id:
        case "coulomb":
            joint.frictionloss += value["level"]
        case "viscous":
            joint.damping = joint.damping + [value["coefficient"], 0.0, 0.0]
        case "nonlinear_viscous":
            joint.damping = joint.damping + [0.0, value["quadratic"], value["cubic"]]
        case "spring" if (k := joint.stiffness[0] + value["stiffness"]) > 0:
            preload = value["preload"] - joint.stiffness[0] * joint.springref
            joint.stiffness, joint.springref = np.array([k, 0.0, 0.0]), -preload / k
        case "spring":
            _pull(motor, -value["preload"], -value["stiffness"])
        case "torque_offset" | "asymmetric_friction":
            # The friction is the same as long as the joint moves.
            _pull(motor, -value["level"])
            return effect.id == "torque_offset"
        case "torque_gain":
            motor.gainprm[0] /= 1.0 + value["gain"]
        case "actuator_lag" if value["time"] > 0:
            _follow(motor, value["time"])
        case "saturation" if value["loss"] > _CLIPS:
            motor.forcelimited = True
            motor.forcerange = np.array([-1.0, 1.0]) * value["limit"]
        case _:
            return False
    return True


def _pull(motor: Any, constant: float, along: float = 0.0) -> None:
    """Let a motor pull by itself: a constant, and a part along its position."""
    motor.biastype = _AFFINE
    motor.biasprm[0] += constant
    motor.biasprm[1] += along


def _follow(motor: Any, time: float) -> None:
    """Let a motor follow its control as a first-order lag."""
    motor.dyntype = _FIRST_ORDER
    motor.dynprm[0] = time


def _as_friction(
    spec: mujoco.MjSpec, gap: Gap, robot: Robot, effect: Effect
) -> str | None:
    """Let dry and viscous friction stand in for a law, where they come near it.

    Returns:
        What was done, in words; nothing where they do not.
    """
    if effect.id == "asymmetric_friction":
        return "as a constant torque, at standstill too"
    alien = effect.reports or effect.observes or drives(effect)
    if len(effect.joints) > 1 or alien:
        return None
    (j,), parts = effect.joints, []
    for motion, _, sampler in gap:
        torque = effect.torque(motion, RigidBody(robot.chain, motion))
        parts.append(torque[:: sampler.factor, 0])
    moving = gap.moving[:, j]
    v, tau = gap.sampled.v[moving, j], np.concatenate(parts)[moving]
    columns = np.stack([np.sign(v), v], axis=1)
    friction = np.linalg.lstsq(columns, tau, rcond=None)[0]
    size = np.linalg.norm(tau)
    missed = np.linalg.norm(tau - columns @ friction) / size if size > 0 else 1.0
    if missed > _MOST_MISSED:
        return None
    joint = spec.joint(robot.joints[j])
    joint.frictionloss += friction[0]
    joint.damping = joint.damping + [friction[1], 0.0, 0.0]
    return f"as dry and viscous friction, which miss {missed:.0%} of its torque"


def _without_sense(spec: mujoco.MjSpec, robot: Robot) -> list[str]:
    """Cut friction below zero, which would drive a joint; what was cut, in words."""
    notes = []
    for name in robot.joints:
        joint = spec.joint(name)
        if joint.frictionloss < 0 or joint.damping[0] < 0:
            notes.append(f"friction of {name} below zero, which is left at zero")
        joint.frictionloss = max(joint.frictionloss, 0.0)
        joint.damping = np.maximum(joint.damping, [0.0, -np.inf, -np.inf])
    return notes
