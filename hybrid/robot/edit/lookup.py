"""Compile an edited MJCF document, and find its joints by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hybrid.errors import RobotError
from hybrid.robot.edit.document import Document, Tag
from hybrid.robot.mujoco_model import compile_spec
from hybrid.robot.robot import Robot


def model_of(document: Document, robot: Robot) -> Any:
    """Compile the document in the folder of the arm's file."""
    return compile_spec(spec_of(document, robot), robot.path)[0]


def spec_of(document: Document, robot: Robot) -> Any:
    """Parse the document as a MuJoCo spec, in the folder of the arm's file."""
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(document.edited().decode())
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{robot.path}: cannot be edited ({reason})") from error
    spec.modelfiledir = str(Path(robot.path).parent)
    return spec


def joint_tag(document: Document, name: str) -> Tag:
    """Find the element of a joint."""
    for kind in ("joint", "freejoint"):
        for tag in document.find(kind, name=name):
            if "worldbody" in tag.path:
                return tag
    raise RobotError(
        f"{document.where}: joint {name!r} is not in the file; valid are joints with "
        "names, outside of replicate and attach"
    )
