"""Write an arm as a robot file without shapes, where its own file is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.robot.build import spec_text
from hybrid.robot.edit.document import element, text_of
from hybrid.robot.edit.urdf import inertial_text, rotor_text
from hybrid.robot.robot import Robot
from hybrid.robot.spatial import central_inertia


def mjcf_skeleton(robot: Robot) -> str:
    """Links, joints and limits as MJCF, with a motor of unit gear at each joint.

    Dry friction is left to the edit, which makes it hard.
    """
    spec = replace(robot, frictionloss=0.0 * robot.frictionloss).mujoco_spec()
    add_motors(spec, robot)
    spec.compile()
    return spec_text(spec)


def add_motors(spec: object, robot: Robot) -> None:
    """Give a spec without actuators motors, and the limits that MJCF can say."""
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)  # type: ignore[attr-defined]
        if np.isfinite(robot.q_min[k]) and np.isfinite(robot.q_max[k]):
            joint.limited = 1
            joint.range = np.array([robot.q_min[k], robot.q_max[k]])
        if np.isfinite(robot.tau_max[k]):
            joint.actfrclimited = 1
            joint.actfrcrange = np.array([-1.0, 1.0]) * robot.tau_max[k]
        motor = spec.add_actuator(name=name, target=name)  # type: ignore[attr-defined]
        motor.trntype = 0  # at the joint
        motor.gainprm[0] = motor.gear[0] = 1.0
    for name, values in (
        ("velocity_limit", robot.v_max),
        ("acceleration_limit", robot.a_max),
    ):
        if np.isfinite(values).all():
            numeric = spec.add_numeric(name=name, size=robot.size)  # type: ignore[attr-defined]
            numeric.data = values


def urdf_skeleton(robot: Robot) -> str:
    """Links, joints and limits as URDF."""
    drake = "http://drake.mit.edu"
    lines = [
        f'<robot name="{text_of(robot.name)}" xmlns:drake="{drake}">',
        '  <link name="link_0"/>',
    ]
    for k, joint in enumerate(robot.joints):
        text = inertial_text(*central_inertia(robot.chain.inertial[k]))
        lines.append(f'  <link name="link_{k + 1}">\n    {text}\n  </link>')
        lines.append(_joint(robot, k))
        if robot.chain.armature[k] > 0:
            lines.append(f"  {rotor_text(joint, robot.chain.armature[k])}")
    return "\n".join([*lines, "</robot>", ""])


def _joint(robot: Robot, k: int) -> str:
    chain, name = robot.chain, robot.joints[k]
    limited = np.isfinite(robot.q_min[k]) and np.isfinite(robot.q_max[k])
    kind = "prismatic" if not chain.revolute[k] else "revolute"
    if kind == "revolute" and not limited:
        kind = "continuous"
    angles = Rotation.from_matrix(chain.rotation[k]).as_euler("xyz")
    limits = {
        key: x if np.isfinite(x) else 0.0  # 0 is read as none
        for key, x in (("effort", robot.tau_max[k]), ("velocity", robot.v_max[k]))
    }
    if limited:
        limits |= {"lower": robot.q_min[k], "upper": robot.q_max[k]}
    if np.isfinite(robot.a_max[k]):
        limits["drake:acceleration"] = robot.a_max[k]
    friction = {"damping": robot.damping[k], "friction": robot.frictionloss[k]}
    inner = (
        element("origin", {"xyz": chain.translation[k], "rpy": angles}),
        element("parent", {"link": f"link_{k}"}),
        element("child", {"link": f"link_{k + 1}"}),
        element("axis", {"xyz": chain.axis[k]}),
        element("limit", limits),
        element("dynamics", friction),
    )
    text = "".join(f"\n    {x}" for x in inner)
    return f'  <joint name="{text_of(name)}" type="{kind}">{text}\n  </joint>'
