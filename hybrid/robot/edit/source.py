"""Choose the document to edit: the arm's own file, or one made from the arm."""

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot.build import add_motors, mjcf_skeleton, spec_text
from hybrid.robot.edit.document import Document, spec_of
from hybrid.robot.edit.urdf_from_mjcf import urdf_from_mjcf
from hybrid.robot.mjcf import fields_of_mujoco
from hybrid.robot.mujoco_model import compile_spec
from hybrid.robot.read import URDF
from hybrid.robot.robot import Robot
from hybrid.robot.urdf import read_urdf


@dataclass(frozen=True)
class Source:
    """The file that is edited.

    Attributes:
        document: The file.
        robot: The arm in it.
        own: Whether it is the arm's file or made from it, and so may name other files.
        notes: What the arm's own file has and this one lacks, in words.
    """

    document: Document
    robot: Robot
    own: bool
    notes: tuple[str, ...] = ()


def source(robot: Robot, kind: str) -> Source:
    """Choose the file to edit: the arm's own, or one that is made from it.

    A xacro file is expanded. MuJoCo converts a URDF file to MJCF, with shapes if it
    finds the meshes. An MJCF file is converted to URDF with the shapes that URDF can
    express. For an arm without a file, the new file has links and joints only.

    Raises:
        RobotError: The arm's own file is of another arm.
    """
    path = Path(robot.path)
    exists, urdf = path.is_file(), path.suffix.lower() in URDF
    if exists:
        document, own_kind = Document.load(path), "urdf" if urdf else "mjcf"
        found = read(document, robot, own_kind)
        if found.fingerprint() != robot.fingerprint():
            raise RobotError(f"{path}: is of another arm than {robot.name!r}")
        if kind == own_kind:
            return Source(document, found, True)
    text, notes, own = "", tuple[str, ...](), exists
    if exists and urdf:
        text = _converted(robot)
    elif exists:
        text, notes = urdf_from_mjcf(robot)
    if not text:
        own, robot = False, replace(robot, held={})
        text = mjcf_skeleton(robot) if kind == "mjcf" else urdf_from_mjcf(robot)[0]
    document = Document(text.encode(), path)
    return Source(document, read(document, robot, kind), own, notes)


def read(document: Document, robot: Robot, kind: str) -> Robot:
    """Read the arm from a document without warnings, which its file caused before."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        if kind == "urdf":
            content, where = document.edited(), document.where
            fields = read_urdf(content, where, robot.joints, dict(robot.held))
            return Robot(**fields, path=robot.path)
        model, missing = compile_spec(spec_of(document, robot), robot.path)
        fields = fields_of_mujoco(model, robot.path, robot.joints, robot.held, missing)
        return Robot(**{**fields, "name": robot.name, "path": robot.path})


def _converted(robot: Robot) -> str:
    """Convert a URDF file to MJCF; empty if MuJoCo does not read the same arm."""
    try:
        spec = spec_of(Document.load(robot.path), robot)
        spec.compiler.discardvisual = False
        spec.compiler.fusestatic = False
        add_motors(spec, robot)
        spec.compile()
        text = spec_text(spec)
        document = Document(text.encode(), robot.path)
        same = read(document, robot, "mjcf").fingerprint() == robot.fingerprint()
    except (ValueError, RobotError, AttributeError):
        return ""
    return text if same else ""
