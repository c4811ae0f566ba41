"""URDF file -> chain and declared properties, read by pinocchio.

Rotor inertia and acceleration limits, which plain URDF has no place for, are read from
Drake's tags: ``drake:rotor_inertia`` and ``drake:gear_ratio`` of a transmission's
actuator, and the attribute ``drake:acceleration`` of a joint's limit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.chain import Chain
from hybrid.robot.selection import serial_joints


def read_urdf(path: Path, joints: tuple[str, ...] | None) -> dict[str, Any]:
    """Fields of a :class:`~hybrid.robot.robot.Robot` read from a URDF file.

    Args:
        path: The URDF file; meshes are not needed.
        joints: Joints to keep, or None for the arm that the file's tree holds.

    Raises:
        RobotError: The file is not a URDF, or holds no serial arm.
    """
    import pinocchio as pin

    try:
        tree = pin.buildModelFromUrdf(str(path))
    except (ValueError, RuntimeError) as error:
        raise RobotError(
            f"{path}: not a readable URDF; a <robot> with a name, links and joints is "
            "needed"
        ) from error
    names = tuple(tree.names)[1:]
    parents = {
        name: names[tree.parents[k + 1] - 1] if tree.parents[k + 1] else None
        for k, name in enumerate(names)
    }
    keep = serial_joints(parents, joints, path)
    index = [tree.getJointId(name) for name in keep]
    for name, j in zip(keep, index, strict=True):
        if tree.nvs[j] != 1:
            raise RobotError(
                f"{path}: joint {name!r} is {tree.joints[j].shortname()}; valid are "
                "revolute, continuous and prismatic joints on a fixed base"
            )
    fields = _fields(tree, index)
    armature, acceleration = _drake_tags(path)
    chain = fields["chain"]
    fields["chain"] = replace(
        chain, armature=chain.armature + _by_joint(armature, chain.joints, 0.0)
    )
    fields["a_max"] = _by_joint(acceleration, chain.joints, np.inf)
    return fields


def _drake_tags(path: Path) -> tuple[dict[str, float], dict[str, float]]:
    """Reflected rotor inertia [kg·m²] and acceleration limit [rad/s²] by joint."""
    content = path.read_bytes()
    if b"drake:" not in content:
        return {}, {}
    # Many files use prefixes that they never declare: read them as plain names.
    content = re.sub(rb"(</?|\s)(\w+):(?=\w)", rb"\1\2_", content)
    try:
        root = ElementTree.fromstring(content)
        armature, acceleration = {}, {}
        for drive in root.iter("transmission"):
            joint, actuator = drive.find("joint"), drive.find("actuator")
            rotor = None if actuator is None else actuator.find("drake_rotor_inertia")
            if joint is None or actuator is None or rotor is None:
                continue
            gear = actuator.find("drake_gear_ratio")
            ratio = 1.0 if gear is None else float(gear.attrib["value"])
            armature[joint.attrib["name"]] = (
                float(rotor.attrib["value"]) * ratio * ratio
            )
        for element in root.iter("joint"):
            limit = element.find("limit")
            if limit is not None and "drake_acceleration" in limit.attrib:
                value = float(limit.attrib["drake_acceleration"])
                acceleration[element.attrib["name"]] = value
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise RobotError(f"{path}: unreadable drake: tags ({error})") from error
    return armature, acceleration


def _by_joint(
    values: Mapping[str, float], joints: tuple[str, ...], default: float
) -> np.ndarray:
    return np.array([values.get(name, default) for name in joints])


def _fields(model: Any, index: list[int]) -> dict[str, Any]:
    """Fields of the arm made of the joints ``index`` of a pinocchio tree."""
    chain = _chain(model, index)
    n = chain.size
    q_min, q_max = np.full(n, -np.inf), np.full(n, np.inf)
    for k, j in enumerate(index):
        if model.nqs[j] == 1:  # a continuous joint is stored as (cos, sin)
            q_min[k] = model.lowerPositionLimit[model.idx_qs[j]]
            q_max[k] = model.upperPositionLimit[model.idx_qs[j]]
    dofs = [model.idx_vs[j] for j in index]
    return {
        "name": model.name,
        "chain": chain,
        "q_min": q_min,
        "q_max": q_max,
        "v_max": _limit(model.upperVelocityLimit[dofs]),
        "tau_max": _limit(model.upperEffortLimit[dofs]),
        "damping": np.array(model.damping[dofs]),
        "frictionloss": np.array(model.upperDryFrictionLimit[dofs]),
    }


def _chain(model: Any, index: list[int]) -> Chain:
    """Walk the tree; what a frozen joint carries is welded to its parent link."""
    import pinocchio as pin

    n = len(index)
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    placement: list[Any] = [pin.SE3.Identity()] * n
    axis, revolute = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    inertial = np.zeros((n, 10))
    # Where each joint sits in the link it belongs to: (link, placement).
    home = {0: (-1, pin.SE3.Identity())}
    for j in range(1, model.njoints):
        link, pose = home[model.parents[j]]
        pose = pose * model.jointPlacements[j]
        if j in index:
            link, placement[index.index(j)] = index.index(j), pose
            axis[link], revolute[link] = _motion_axis(model, data, j)
            pose = pin.SE3.Identity()
        home[j] = (link, pose)
        if link >= 0:
            inertial[link] += pose.act(model.inertias[j]).toDynamicParameters()
    return Chain(
        joints=tuple(model.names[j] for j in index),
        rotation=np.array([pose.rotation for pose in placement]),
        translation=np.array([pose.translation for pose in placement]),
        axis=axis,
        revolute=revolute,
        inertial=inertial,
        gravity=np.array(model.gravity.linear),
        armature=np.array(model.armature[[model.idx_vs[j] for j in index]]),
    )


def _motion_axis(model: Any, data: Any, joint: int) -> tuple[np.ndarray, bool]:
    """Axis of a joint in its own frame, and whether it turns about it."""
    import pinocchio as pin

    # In the joint's own frame the motion subspace is constant: the axis. (The Jacobian
    # of a one-joint model comes as a vector.)
    jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
    column = jacobian[:, model.idx_vs[joint]]
    revolute = bool(np.linalg.norm(column[3:]) > 0.5)
    return (column[3:] if revolute else column[:3]), revolute


def _limit(values: Any) -> np.ndarray:
    """Upper limits with "none" (0 in many files) read as infinity."""
    limit = np.array(values, dtype=float)
    limit[(limit <= 0) | (limit > 1e300)] = np.inf
    return limit
