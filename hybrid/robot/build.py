"""Build a pinocchio model and a MuJoCo spec from a chain."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.errors import RobotError
from hybrid.extras import check_extra
from hybrid.robot.spatial import ROUNDED, central_inertia

if TYPE_CHECKING:
    import pinocchio

    from hybrid.robot.robot import Robot

# MuJoCo needs positive mass and inertia; these are negligible.
_SMALLEST_MASS, _SMALLEST_INERTIA = 1e-9, 1e-12


def pinocchio_model(robot: Robot) -> pinocchio.Model:
    """See :meth:`hybrid.robot.robot.Robot.pinocchio`."""
    check_extra("pinocchio", "pin", "A model of pinocchio")
    import pinocchio as pin

    chain = robot.chain
    model = pin.Model()
    model.name = robot.name
    model.gravity.linear = chain.gravity
    parent = 0
    turn, slide = pin.JointModelRevoluteUnaligned, pin.JointModelPrismaticUnaligned
    for k, name in enumerate(chain.joints):
        kind = turn if chain.revolute[k] else slide
        placement = pin.SE3(chain.rotation[k], chain.translation[k])
        parent = model.addJoint(parent, kind(*chain.axis[k]), placement, name)
        inertia = pin.Inertia(*central_inertia(chain.inertial[k]))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    model.armature = chain.armature.copy()
    return model


def mujoco_spec(robot: Robot) -> mujoco.MjSpec:
    """See :meth:`hybrid.robot.robot.Robot.mujoco_spec`."""
    chain = robot.chain
    spec = mujoco.MjSpec()
    spec.modelname = robot.name
    spec.option.gravity = chain.gravity
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    parent = spec.worldbody
    turn, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
    for k, name in enumerate(chain.joints):
        body = parent.add_body(name=name, pos=chain.translation[k])
        body.quat = Rotation.from_matrix(chain.rotation[k]).as_quat(scalar_first=True)
        _set_inertia(body, chain.inertial[k], name)
        kind = turn if chain.revolute[k] else slide
        joint = body.add_joint(name=name, type=kind, axis=chain.axis[k])
        joint.armature = chain.armature[k]
        joint.damping = np.array([robot.damping[k], robot.quadratic[k], robot.cubic[k]])
        joint.frictionloss = robot.frictionloss[k]
        joint.stiffness = np.array([robot.stiffness[k], 0, 0])
        joint.springref = robot.springref[k]
        parent = body
    for first, second, inertia, damping, dry in robot.coupled:
        pair = [robot.joints[int(j)] for j in (first, second)]
        rotor = spec.add_tendon(name="+".join(pair))
        for name in pair:
            rotor.wrap_joint(name, 1.0)
        rotor.armature, rotor.damping[0], rotor.frictionloss = inertia, damping, dry
    for number, (j, stiffness, rest, knee) in enumerate(robot.stiffening, 1):
        hose = spec.add_tendon(name=f"{robot.joints[int(j)]}/hose_{number}")
        hose.wrap_joint(robot.joints[int(j)], 1.0)
        hose.stiffness = np.array([stiffness, 0.0, stiffness / knee**2])
        hose.springlength = np.array([rest, rest])
    return spec


def spec_text(spec: mujoco.MjSpec) -> str:
    """Write a spec as MJCF with all digits; MuJoCo itself writes six."""
    from mujoco import _structs

    # A function of MuJoCo for its own tests; there is no public one.
    library = ctypes.CDLL(_structs.__file__)
    try:
        digits = library._mjPRIVATE__get_xml_precision()
        library._mjPRIVATE__set_xml_precision(17)
    except AttributeError as error:
        raise RobotError("this version of MuJoCo writes six digits only") from error
    try:
        return str(spec.to_xml())
    finally:
        library._mjPRIVATE__set_xml_precision(digits)


def mjcf_skeleton(robot: Robot) -> str:
    """MJCF of links, joints and limits, with a motor of gear 1 at each joint.

    The later edit of the file adds dry friction and couplings, as hard as it can.
    """
    smooth = replace(
        robot, frictionloss=0.0 * robot.frictionloss, coupled=robot.coupled[:0]
    )
    spec = mujoco_spec(smooth)
    add_motors(spec, robot)
    spec.compile()
    return spec_text(spec)


def add_motors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add motors and limits to a spec without actuators."""
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)
        ends = np.array([robot.q_min[k], robot.q_max[k]])
        if np.isfinite(ends).all():
            joint.limited, joint.range = 1, ends
        if np.isfinite(robot.tau_max[k]):
            joint.actfrclimited = 1
            joint.actfrcrange = np.array([-1.0, 1.0]) * robot.tau_max[k]
        motor = spec.add_actuator(name=name, target=name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
        motor.gainprm[0] = motor.gear[0] = 1.0
    limits = {"velocity_limit": robot.v_max, "acceleration_limit": robot.a_max}
    for name, values in limits.items():
        if np.isfinite(values).all():
            spec.add_numeric(name=name, size=robot.size).data = values


def simulable(
    mass: float, center: np.ndarray, inertia: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Adapt mass and central inertia to MuJoCo, which needs both above zero."""
    _, _, c = moments = np.linalg.eigvalsh(inertia)
    excess = 2 * c - moments.sum()
    if 0 < excess <= ROUNDED * c:  # rounding violates the triangle inequality
        inertia = inertia + 2 * excess * np.eye(3)
    lifted = np.where(np.eye(3), np.maximum(inertia, _SMALLEST_INERTIA), inertia)
    return max(mass, _SMALLEST_MASS), center, lifted


def _set_inertia(body: mujoco.MjsBody, inertial: np.ndarray, name: str) -> None:
    mass, center, inertia = central_inertia(inertial)
    if mass < 0 or np.linalg.eigvalsh(inertia)[0] < -1e-6 * max(1.0, mass):
        raise RobotError(
            f"link {name!r} has no physical inertia (mass {mass:g} kg); "
            "MuJoCo cannot simulate it"
        )
    body.explicitinertial = True
    body.mass, body.ipos, inertia = simulable(mass, center, inertia)
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
