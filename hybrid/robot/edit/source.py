"""The document to edit: the arm's own file, or one made from the arm."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot.build import spec_text
from hybrid.robot.edit.document import Document
from hybrid.robot.edit.mjcf import check_mjcf
from hybrid.robot.edit.skeleton import add_motors, mjcf_skeleton, urdf_skeleton
from hybrid.robot.edit.urdf import check_urdf
from hybrid.robot.robot import Robot


def source(robot: Robot, kind: str) -> tuple[Document, Robot, bool]:
    """The document to edit, the arm that it has, and whether it is the arm's own file.

    A URDF file becomes an MJCF file by MuJoCo, with shapes if it finds the meshes. An
    arm without a file, and an MJCF one as URDF, has links and joints only, as they
    shall be.

    Args:
        robot: The arm as it shall be; ``path`` is its file.
        kind: ``mjcf`` or ``urdf``.

    Raises:
        RobotError: The file is of another arm.
    """
    path = Path(robot.path)
    suffix = path.suffix.lower()
    there = bool(robot.path) and path.is_file() and suffix != ".xacro"
    if there and (kind == "urdf") == (suffix == ".urdf"):
        document = Document.load(path)
        found = read(document, robot, kind)
        if found.fingerprint() != robot.fingerprint():
            raise RobotError(f"{path}: is of another arm than {robot.name!r}")
        return document, found, True
    if there and suffix == ".urdf" and (text := _converted(robot)):
        document = Document(text.encode(), path)
        return document, read(document, robot, kind), True
    text = mjcf_skeleton(robot) if kind == "mjcf" else urdf_skeleton(robot)
    document = Document(text.encode(), path)
    return document, read(document, replace(robot, held={}), kind), False


def read(document: Document, robot: Robot, kind: str) -> Robot:
    """The arm that a document has; what a reader warns of, it did of the arm's file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        return (check_urdf if kind == "urdf" else check_mjcf)(document, robot)


def _converted(robot: Robot) -> str:
    """A URDF file as MJCF; nothing where MuJoCo does not read this arm."""
    import mujoco

    try:
        spec: Any = mujoco.MjSpec.from_file(robot.path)
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
