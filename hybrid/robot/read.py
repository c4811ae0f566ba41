"""Read a robot from a file, a name, or a model of another library."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.demand import check_demand
from hybrid.robot.edit.markup import markup, read_markup
from hybrid.robot.library import robot_file
from hybrid.robot.mjcf import fields_of_mujoco
from hybrid.robot.mujoco_model import compile_spec, compile_without_assets
from hybrid.robot.tree import Node, Tree, serial_joints
from hybrid.robot.urdf import limit, range_of, read_urdf

URDF = (".urdf", ".xacro")
SUFFIXES = (".urdf", ".xml", ".mjcf", ".xacro")
Read = tuple[dict[str, Any], Any]  # fields, and MuJoCo's model or None


def read_robot(
    source: Any, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> Read:
    """Read the fields of a robot from a file, a name, or another library's model."""
    match source:
        case mujoco.MjModel():
            model = source.__copy__()
            return fields_of_mujoco(model, "MjModel", joints, held, {}), model
        case mujoco.MjSpec():
            model, missing = compile_spec(source.copy(), "MjSpec")
            return fields_of_mujoco(model, "MjSpec", joints, held, missing), model
        case str() | Path():
            path = robot_file(source)
            try:
                return _of_file(path, joints, held)
            except RobotError as error:
                if str(path) in str(error):
                    raise
                raise RobotError(f"{path}: {error}") from error
            except UnicodeDecodeError as error:
                fault = f"a name in it is not UTF-8 ({error})"
                raise RobotError(f"{path}: {fault}") from error
    home, name = type(source).__module__.partition(".")[0], type(source).__name__
    if (home, name) == ("pinocchio", "Model"):
        return _of_pinocchio(source, joints, held), None
    raise RobotError(
        f"{home}.{name} is no robot; valid are a file, a name, mujoco.MjModel, "
        "mujoco.MjSpec and pinocchio.Model"
    )


def _of_file(
    path: Path, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> Read:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise RobotError(
            f"{path}: unknown kind of robot file; valid are {', '.join(SUFFIXES)}"
        )
    if not path.is_file():
        raise RobotError(f"{path}: no such robot file")
    if suffix in URDF:
        content = urdf_content(path)
        return {**read_urdf(content, path, joints, held), "path": str(path)}, None
    check_demand(path)
    first = next(markup(read_markup(path.read_bytes()), path), None)
    if first and first.name == "robot":  # MuJoCo reads it, but not its limits
        raise RobotError(
            f"{path}: not a readable MJCF but a URDF; valid is the ending .urdf"
        )
    model, missing = compile_without_assets(path)
    fields = fields_of_mujoco(model, str(path), joints, held, missing)
    return {**fields, "name": path.stem, "path": str(path)}, model


def _of_pinocchio(
    model: Any, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> dict[str, Any]:
    tree = _tree(model)
    keep = serial_joints(tree, joints, held)
    held = tree.held(held)
    index = [model.getJointId(name) for name in keep]
    endless = [model.nqs[j] > 1 for j in index]  # stored as (cos, sin)
    dofs, at = [model.idx_vs[j] for j in index], [model.idx_qs[j] for j in index]
    gravity, armature = np.array(model.gravity.linear), np.array(model.armature[dofs])
    return {
        "name": model.name,
        "chain": tree.chain(keep, held, gravity, armature),
        "held": held,
        **range_of(model.lowerPositionLimit[at], model.upperPositionLimit[at], endless),
        "v_max": limit(model.upperVelocityLimit[dofs]),
        "tau_max": limit(model.upperEffortLimit[dofs]),
        "damping": np.array(model.damping[dofs]),
        "frictionloss": np.array(model.upperDryFrictionLimit[dofs]),
    }


def _tree(model: Any) -> Tree:
    """Tree of a pinocchio model; bodies that are fixed to a joint are one body."""
    import pinocchio as pin

    links: dict[int, str] = {}
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            links.setdefault(frame.parentJoint, frame.name)
    leaders = dict(zip(model.mimicking_joints, model.mimicked_joints, strict=True))
    nodes = []
    for j in range(1, model.njoints):
        name, joint, body = model.names[j], model.joints[j], model.inertias[j]
        kind = joint.shortname().removeprefix("JointModel")
        screw, follows = np.zeros(6), None
        if joint.nvExtended == 1:
            screw, kind = np.ravel(joint.createData().S), ""
        if j in leaders:
            own = joint.extract()
            screw = screw / (own.scaling or 1.0)
            follows = (model.names[leaders[j]], own.scaling, own.offset)
        revolute = bool(screw[3:].any())
        node = Node(
            parent=int(model.parents[j]) - 1,
            rotation=np.array(model.jointPlacements[j].rotation),
            translation=np.array(model.jointPlacements[j].translation),
            joint=name,
            kind=kind and ("is free" if kind == "FreeFlyer" else f"is {kind.lower()}"),
            follows=follows,
            axis=screw[3:] if revolute else screw[:3],
            revolute=revolute,
            body=j,
            name=links.get(j, name),
            mass=body.mass,
            center=np.array(body.lever),
            inertia=np.array(body.inertia),
        )
        nodes.append(node)
    return Tree("pinocchio.Model", nodes)


def urdf_content(path: Path) -> bytes:
    """Content of a URDF file; a xacro file is expanded."""
    if path.suffix.lower() != ".xacro":
        check_demand(path)
        return path.read_bytes()
    command = f"xacro {path.name} > {path.name.split('.')[0]}.urdf"
    try:
        import xacro
    except ModuleNotFoundError as error:
        raise RobotError(
            f"{path}: install xacro to expand it, or run `{command}`"
        ) from error
    try:
        return str(xacro.process_file(str(path)).toxml()).encode()
    except Exception as error:  # expressions in the file raise any type
        reason = " ".join(str(error).split())
        raise RobotError(
            f"{path}: xacro cannot expand it ({reason}); try `{command}`"
        ) from error
