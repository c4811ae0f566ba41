"""Faults of arms with position servos that are changes of a MuJoCo model."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.effects.backlash import Backlash
from hybrid.robot import Robot
from hybrid.servo.model import declared_spec

FAULTS = (
    "none", "controller_gain", "viscous", "coulomb", "armature", "saturation",
    "torque_offset", "command_latency", "encoder_offset", "stribeck", "payload",
    "spring", "deadzone", "backlash", "goal_speed", "contact", "sign",
    "load_friction", "nonlinear_viscous", "gravity_tilt",
)  # fmt: skip


def spoilt(robot: Robot, fault: str, j: int) -> mujoco.MjModel:
    """An arm with the servos of its file but for a fault at joint j."""
    spec, stall = declared_spec(robot), robot.tau_max[j]
    if fault == "backlash":
        effect = Backlash(joints=(j,), values={"half_width": 0.02})
        effect.edit_spec(spec, robot.joints)
    model = spec.compile()
    d = int(model.joint(robot.joints[j]).qposadr[0])
    match fault:
        case "controller_gain":
            model.actuator_gainprm[j, 0] *= 0.6
            model.actuator_biasprm[j, 1] *= 0.6
        case "viscous":
            model.dof_damping[d] += robot.kd[j]
        case "coulomb":
            model.dof_frictionloss[d] += 0.06 * stall
        case "nonlinear_viscous":
            model.dof_dampingpoly[d, 0] += 0.15 * stall
        case "gravity_tilt":
            tilt = Rotation.from_rotvec([0.1, -0.05, 0.0])
            model.opt.gravity = tilt.apply(model.opt.gravity)
        case "armature":
            model.dof_armature[d] *= 3.0
        case "saturation":
            model.actuator_forcerange[j] = np.array([-0.05, 0.05]) * stall
        case "torque_offset":
            model.jnt_stiffness[d], model.qpos_spring[d] = 1e-6, 0.06e6 * stall
        case "payload":
            model.body_mass[-1] *= 1.8
            model.body_inertia[-1] *= 1.8
            mujoco.mj_setConst(model, mujoco.MjData(model))
        case "spring":
            model.jnt_stiffness[d] = 0.15 * stall
        case "contact":
            middle = (robot.q_min[j] + robot.q_max[j]) / 2
            middle = middle if np.isfinite(middle) else 0.4
            model.jnt_range[d, 1] = middle + 0.15
    return model
