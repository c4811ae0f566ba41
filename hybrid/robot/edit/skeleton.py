"""Write an arm without a file as MJCF without shapes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid.robot.build import spec_text
from hybrid.robot.robot import Robot


def mjcf_skeleton(robot: Robot) -> str:
    """MJCF of links, joints and limits, with a motor of gear 1 at each joint.

    The later edit of the file adds dry friction and couplings, as hard as it can.
    """
    smooth = replace(
        robot, frictionloss=0.0 * robot.frictionloss, coupled=robot.coupled[:0]
    )
    spec = smooth.mujoco_spec()
    add_motors(spec, robot)
    spec.compile()
    return spec_text(spec)


def add_motors(spec: object, robot: Robot) -> None:
    """Add motors and limits to a spec without actuators."""
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)  # type: ignore[attr-defined]
        if np.isfinite(robot.q_min[k]) and np.isfinite(robot.q_max[k]):
            joint.limited = 1
            joint.range = np.array([robot.q_min[k], robot.q_max[k]])
        if np.isfinite(robot.tau_max[k]):
            joint.actfrclimited = 1
            joint.actfrcrange = np.array([-1.0, 1.0]) * robot.tau_max[k]
        motor = spec.add_actuator(name=name, target=name)  # type: ignore[attr-defined]
        motor.trntype = 0  # mjTRN_JOINT
        motor.gainprm[0] = motor.gear[0] = 1.0
    for name, values in (
        ("velocity_limit", robot.v_max),
        ("acceleration_limit", robot.a_max),
    ):
        if np.isfinite(values).all():
            numeric = spec.add_numeric(name=name, size=robot.size)  # type: ignore[attr-defined]
            numeric.data = values
