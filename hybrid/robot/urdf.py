"""URDF file, or pinocchio's model -> chain and declared properties.

What plain URDF has no place for is read from the tags of simulators: rotor inertia and
acceleration limits from Drake's (``drake:rotor_inertia`` and ``drake:gear_ratio`` of a
transmission's actuator, ``drake:acceleration`` of a joint's limit), springs from
Gazebo's (``springStiffness`` and ``springReference``).
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
from hybrid.robot.selection import Tree, serial_joints
from hybrid.robot.spatial import inertia_fault

Follower = tuple[str, float, float]  # of which joint, by which ratio, from where


def read_urdf(
    path: Path, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> dict[str, Any]:
    """Fields of a :class:`~hybrid.robot.robot.Robot` read from a URDF file.

    Args:
        path: The URDF file; meshes are not needed.
        joints: Joints to keep, or None for the arm that the file's tree holds.
        held: Positions of other joints, [rad or m].

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
    root = _root(path)
    try:
        tags, mimic = _tags(root), _mimic(root)
    except (KeyError, ValueError) as error:
        raise RobotError(
            f"{path}: unreadable mimic, drake: or gazebo tag ({error})"
        ) from error
    fields = fields_of_pinocchio(tree, str(path), joints, held, mimic)
    chain = fields["chain"]
    rotors = np.array([tags["armature"].get(name, 0.0) for name in chain.joints])
    fields["chain"] = replace(chain, armature=chain.armature + rotors)
    for name, none in (("a_max", np.inf), ("stiffness", 0.0), ("springref", 0.0)):
        fields[name] = np.array([tags[name].get(x, none) for x in chain.joints])
    return fields


def fields_of_pinocchio(
    model: Any,
    where: str,
    joints: tuple[str, ...] | None,
    held: Mapping[str, float],
    mimic: Mapping[str, Follower],
) -> dict[str, Any]:
    """Fields of a :class:`~hybrid.robot.robot.Robot` read from pinocchio's model.

    Args:
        model: pinocchio's model.
        where: The file or object, for messages.
        joints: Joints to keep, or None for the arm that the tree holds.
        held: Positions of other joints, [rad or m].
        mimic: Followers that the model has as independent joints.

    Raises:
        RobotError: There is no serial arm, or a link is no body that could be built.
    """
    names = tuple(model.names)
    own = zip(model.mimicking_joints, model.mimicked_joints, strict=True)
    followers = {names[i]: names[j] for i, j in own}
    followers |= {name: leader for name, (leader, _, _) in mimic.items()}
    parents, kinds = {}, {}
    for j, name in enumerate(names[1:], 1):
        parents[name] = names[model.parents[j]] if model.parents[j] else None
        if name in followers:
            kinds[name] = f"follows joint {followers[name]!r} (mimic)"
        elif model.nvs[j] != 1:
            kind = model.joints[j].shortname().removeprefix("JointModel")
            kinds[name] = "is free" if kind == "FreeFlyer" else f"is {kind.lower()}"
    keep = serial_joints(Tree(where, parents, kinds, followers.values()), joints, held)
    for follower, leader in followers.items():
        if leader in keep:
            raise RobotError(
                f"joint {follower!r} follows joint {leader!r} of the arm (mimic), "
                "which moves both; choose joints without it"
            )
    index = [model.getJointId(name) for name in keep]
    _check_links(model, index)
    moved = {
        name: ratio * held.get(leader, 0.0) + offset
        for name, (leader, ratio, offset) in mimic.items()
    }
    return _fields(model, index, {k: x for k, x in moved.items() if x} | dict(held))


def _check_links(model: Any, index: list[int]) -> None:
    """Refuse what moves and is no body that could be built."""
    for j in range(1, model.njoints):
        if not {*model.supports[j]} & {*index}:
            continue
        fault = inertia_fault(model.inertias[j].mass, model.inertias[j].inertia)
        if fault:
            raise RobotError(f"link {_link(model, j)!r} {fault}")


def _link(model: Any, joint: int) -> str:
    """Name of the link at a joint, or of the joint if that has none."""
    import pinocchio as pin

    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == joint:
            return str(frame.name)
    return str(model.names[joint])


def _root(path: Path) -> ElementTree.Element:
    """The file's elements, if pinocchio leaves out some of them.

    Prefixes, which many files use and never declare, become part of their names.
    """
    content = path.read_bytes()
    if not re.search(rb"<mimic|drake:|<springStiffness", content):
        return ElementTree.Element("robot")
    content = re.sub(rb"(</?|\s)(\w+):(?=\w)", rb"\1\2_", content)
    try:
        return ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise RobotError(f"{path}: not readable XML ({error})") from error


def _mimic(root: ElementTree.Element) -> dict[str, Follower]:
    """What each joint that follows another one follows."""
    return {
        joint.attrib["name"]: (
            tag.attrib["joint"],
            float(tag.get("multiplier", 1.0)),
            float(tag.get("offset", 0.0)),
        )
        for joint in root.iterfind("joint")
        if (tag := joint.find("mimic")) is not None
    }


def _tags(root: ElementTree.Element) -> dict[str, dict[str, float]]:
    """What simulators' tags say of joints, by field and joint."""
    found: dict[str, dict[str, float]] = {
        name: {} for name in ("armature", "a_max", "stiffness", "springref")
    }
    for drive in root.iter("transmission"):
        joint, actuator = drive.find("joint"), drive.find("actuator")
        rotor = None if actuator is None else actuator.find("drake_rotor_inertia")
        if joint is None or actuator is None or rotor is None:
            continue
        gear = actuator.find("drake_gear_ratio")
        ratio = 1.0 if gear is None else float(gear.attrib["value"])
        found["armature"][joint.attrib["name"]] = (
            float(rotor.attrib["value"]) * ratio * ratio
        )
    for element in root.iter("joint"):
        limit = element.find("limit")
        if limit is not None and "drake_acceleration" in limit.attrib:
            value = float(limit.attrib["drake_acceleration"])
            found["a_max"][element.attrib["name"]] = value
    for element in root.iter("gazebo"):
        if (stiffness := element.findtext("springStiffness")) is not None:
            name = element.attrib["reference"]
            found["stiffness"][name] = float(stiffness)
            found["springref"][name] = float(element.findtext("springReference", "0"))
    return found


def _fields(model: Any, index: list[int], held: Mapping[str, float]) -> dict[str, Any]:
    """Fields of the arm made of the joints ``index`` of a pinocchio tree."""
    chain = _chain(model, index, held)
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
        "held": dict(held),
        "q_min": q_min,
        "q_max": q_max,
        "v_max": _limit(model.upperVelocityLimit[dofs]),
        "tau_max": _limit(model.upperEffortLimit[dofs]),
        "damping": np.array(model.damping[dofs]),
        "frictionloss": np.array(model.upperDryFrictionLimit[dofs]),
    }


def start(model: Any, held: Mapping[str, float]) -> np.ndarray:
    """Position of the whole model with some joints held elsewhere, shape (nq,)."""
    import pinocchio as pin

    q = pin.neutral(model)
    for name, position in held.items():
        j = model.getJointId(name)
        circle = [np.cos(position), np.sin(position)]
        at = model.idx_qs[j]
        q[at : at + model.nqs[j]] = circle if model.nqs[j] == 2 else position
    return np.asarray(q)


def _chain(model: Any, index: list[int], held: Mapping[str, float]) -> Chain:
    """Walk the tree; what a held joint carries is welded to its parent link."""
    import pinocchio as pin

    n = len(index)
    data = model.createData()
    pin.computeJointJacobians(model, data, start(model, held))
    placement: list[Any] = [pin.SE3.Identity()] * n
    axis, revolute = np.zeros((n, 3)), np.zeros(n, dtype=bool)
    inertial = np.zeros((n, 10))
    # Where each joint sits in the link it belongs to: (link, placement).
    home = {0: (-1, pin.SE3.Identity())}
    for j in range(1, model.njoints):
        link, pose = home[model.parents[j]]
        pose = pose * data.liMi[j]  # a joint of the arm is at zero
        if j in index:
            link, placement[index.index(j)] = index.index(j), pose
            axis[link], revolute[link] = _motion_axis(model, data, j)
            pose = pin.SE3.Identity()
        home[j] = (link, pose)
        if link >= 0:
            inertial[link] += pose.act(model.inertias[j]).toDynamicParameters()
    for k, j in enumerate(index):
        if not inertial[k].any():
            raise RobotError(
                f"link {_link(model, j)!r} moves and has no inertia; give it an "
                "<inertial>, or choose joints without it"
            )
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
