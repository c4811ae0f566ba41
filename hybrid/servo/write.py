"""Write the servos found into the user's own simulator file."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.errors import RobotError
from hybrid.files import atomic_path
from hybrid.robot import Robot
from hybrid.robot.actuators import motors_of
from hybrid.robot.build import spec_text
from hybrid.robot.edit.change import Edit
from hybrid.robot.edit.document import Document, element, joint_tag, model_of
from hybrid.robot.edit.drives import actuator_tags
from hybrid.robot.edit.extra_friction import remove_passive_motors
from hybrid.robot.edit.mjcf import edit_mjcf, turn_unit
from hybrid.robot.mjcf import joint_names
from hybrid.robot.read import URDF
from hybrid.servo.drive import Drive
from hybrid.servo.model import (
    dampings,
    file_step,
    in_log,
    motors,
    servo_spec,
    springs,
    stops,
)

_CLOSE = 1e-6  # rad: no command exceeds a limit by its rounding
_MOTOR = {
    "gear": 1.0,
    "forcelimited": "false",
    "ctrllimited": "false",
    "actearly": "true",
    "dyntype": "dcmotor",
    "gaintype": "dcmotor",
    "biastype": "dcmotor",
    "input": "pos",
}
_KEPT = ("name", "joint", "jointinparent", "group")


def write_servos(
    robot: Robot, drive: Drive, path: str | Path, asked: Array | None = None
) -> None:
    """Write the robot's MJCF file again with other servos; of a URDF, an MJCF skeleton.

    The attributes of the joints and their actuators change, every other byte stays.
    MJCF cannot express what :class:`DriveQuantity` calls unsaid.

    Args:
        robot: The arm by its file.
        drive: The servos.
        path: File to write.
        asked: Lowest and highest command of every joint in the logs, shape (2, n),
            [rad]. An actuator that clips them loses its control range.

    Raises:
        RobotError: The file is gone, or a joint or actuator stands in another file.
    """
    document = _document(robot)
    if drive["roll"][0] or drive["pitch"][0] or (drive["mass"] != 1.0).any():
        inertial = robot.chain.inertial * drive["mass"][:, None]
        gravity = drive.tilt.turned(robot.chain.gravity)
        chain = replace(robot.chain, inertial=inertial, gravity=gravity)
        edit_mjcf(document, Edit(replace(robot, chain=chain)), robot)
    _set_servos(document, robot, drive, asked)
    with atomic_path(path) as temporary:
        temporary.write_bytes(document.edited())


def _document(robot: Robot) -> Document:
    own = Path(robot.path).suffix.lower() not in URDF
    return Document.load(robot.path) if own else _skeleton(robot)


def clipped(robot: Robot, drive: Drive, asked: Array) -> Mask:
    """Whether actuators of the file clip commands of the logs, (2, n) [rad]; (n,)."""
    return _control(model_of(_document(robot), robot), robot, drive, asked)[1]


def _control(
    model: Any, robot: Robot, drive: Drive, asked: Array | None
) -> tuple[Array, Mask]:
    """Control ranges as positions of the log, (n, 2), [rad], and whether they clip."""
    ends = np.tile([[-np.inf], [np.inf]], robot.size)
    names = joint_names(model)
    for a, joint, gear in motors_of(model):
        # The control of other actuators is a torque or a speed.
        servo = (
            model.actuator_biastype[a] == mujoco.mjtBias.mjBIAS_DCMOTOR
            or model.actuator_biasprm[a, 1]
        )
        limited = servo and model.actuator_ctrllimited[a]
        if limited and names[joint] in robot.joints:
            j = robot.joints.index(names[joint])
            ends[:, j] = np.sort(model.actuator_ctrlrange[a] / gear)
    ranges = in_log(drive, ends)
    least, most = np.full((2, robot.size), np.nan) if asked is None else asked
    clips = (least < ranges[:, 0] - _CLOSE) | (most > ranges[:, 1] + _CLOSE)
    return ranges, np.asarray(clips)


def _skeleton(robot: Robot) -> Document:
    """Links, joints and servos of an arm as MJCF, without shapes."""
    declared = Drive.declared(robot)
    spec = servo_spec(robot, declared)
    for name, ends in zip(robot.joints, stops(declared), strict=True):
        spec.joint(name).range = ends
    spec.option.timestep = file_step(robot)
    spec.compile()
    return Document(spec_text(spec).encode(), robot.path)


def _set_servos(
    document: Document, robot: Robot, drive: Drive, asked: Array | None
) -> None:
    model, step = model_of(document, robot), file_step(robot)
    stiffness, relaxed = springs(robot, drive)
    parameters, joint_damping = motors(robot, drive), dampings(robot, drive)[1]
    limits, declared = stops(drive), stops(Drive.declared(robot))
    control, clips = _control(model, robot, drive, asked)
    holds = np.isfinite(control).all(axis=1) & ~clips
    curves = np.stack([drive["quadratic"], robot.cubic], axis=1).tolist()
    for j, name in enumerate(robot.joints):
        joint = joint_tag(document, name)
        curve, turn = curves[j], turn_unit(document, not robot.chain.revolute[j])
        # `ref` is the angle in the pose that the file draws: the zero of the log.
        reference = model.joint(name).qpos0[0] * turn
        given = {
            # One number, or the coefficients of a polynomial.
            "damping": [joint_damping[j], *curve] if any(curve) else joint_damping[j],
            "frictionloss": 0.0,
            "armature": drive["armature"][j],
            "stiffness": stiffness[j],
            "springref": relaxed[j] * turn,
            "ref": reference - drive["zero"][j] * turn,
        }
        if drive["sign"][j] < 0:
            given["axis"] = -robot.chain.axis[j]
        if (limits[j] != declared[j]).any():
            given |= {"range": limits[j] * turn, "limited": "true"}
        document.set(joint, given)
        motor = _MOTOR | {name: x[j].tolist() for name, x in parameters.items()}
        if holds[j]:
            motor |= {"ctrllimited": "true", "ctrlrange": control[j]}
        if (delay := float(drive["delay"][j])) > 0:
            samples = math.ceil(delay / step) + 1
            motor |= {"delay": delay, "nsample": samples, "interp": "linear"}
        # The motor of the servo has all friction of the joint.
        remove_passive_motors(document, name)
        own = actuator_tags(document, name)
        sections = document.find("mujoco", "actuator")
        if own:
            drop = own[0].attributes.keys() - set(_KEPT) - motor.keys()
            document.set(own[0], motor, drop=drop, name="general")
        elif sections:
            text = element("general", {"name": name, "joint": name, **motor})
            document.insert_child(sections[0], text)
        else:
            raise RobotError(f"{robot.path}: no <actuator> section to put a servo into")
