"""A robot file with other joint placements, and every other byte as it was."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.errors import RobotError
from hybrid.files import atomic_path
from hybrid.robot.chain import Array, Chain
from hybrid.robot.compiled import compiled_without_files
from hybrid.robot.spatial import rotation_from_axis_angle

if TYPE_CHECKING:
    from hybrid.robot.robot import Robot

_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_ATTRIBUTE = r"""\s+{}\s*=\s*("[^"]*"|'[^']*')"""
_TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
_UNMOVED = 1e-12  # m or rad: a joint whose text is left alone


@dataclass(frozen=True)
class Tag:
    """An element's start tag: where it stands, under which tags, its attributes."""

    path: tuple[str, ...]
    parents: tuple[int, ...]  # where the enclosing tags start
    start: int
    end: int
    attributes: dict[str, str]


def write_placements(robot: Robot, chain: Chain, path: str | Path) -> None:
    """Write the robot's own file again, with the joint placements of another chain.

    Args:
        robot: An arm read from a URDF or MJCF file.
        chain: The same joints with other ``rotation`` and ``translation``.
        path: Where the new file shall be.

    Raises:
        RobotError: The file is gone, or a joint's placement has no place in it.
    """
    source = Path(robot.path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise RobotError(f"{source}: cannot be read ({error.strerror})") from error
    changes = _changes(robot.chain, chain)
    found = list(tags(content, source))
    replace = _urdf if source.suffix.lower() == ".urdf" else _mjcf
    edits = replace(content, found, robot, changes)
    for start, end, text in sorted(edits, reverse=True):
        content = content[:start] + text.encode() + content[end:]
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def _changes(old: Chain, new: Chain) -> dict[str, tuple[Array, Array]]:
    """Turn and shift of each moved joint frame, in the frame as it was."""
    changes = {}
    for k, joint in enumerate(old.joints):
        turn = old.rotation[k].T @ new.rotation[k]
        shift = old.rotation[k].T @ (new.translation[k] - old.translation[k])
        if max(abs(turn - np.eye(3)).max(), abs(shift).max()) > _UNMOVED:
            changes[joint] = (turn, shift)
    return changes


def _urdf(
    content: bytes,
    tags: list[Tag],
    robot: Robot,
    changes: dict[str, tuple[Array, Array]],
) -> Iterator[tuple[int, int, str]]:
    for tag in tags:
        joint = tag.attributes.get("name", "")
        if tag.path != ("robot", "joint") or joint not in changes:
            continue
        origin = [
            t for t in tags if t.path[2:] == ("origin",) and t.parents[-1] == tag.start
        ]
        xyz, rpy = np.zeros(3), np.zeros(3)
        if origin:
            xyz = _numbers(origin[0].attributes.get("xyz", "0 0 0"))
            rpy = _numbers(origin[0].attributes.get("rpy", "0 0 0"))
        turn, shift = changes[joint]
        R = Rotation.from_euler("xyz", rpy).as_matrix()
        angles = _roll_pitch_yaw(R @ turn)
        text = f'<origin xyz="{_text(xyz + R @ shift)}" rpy="{_text(angles)}"'
        if origin:
            closing = "/>" if content[: origin[0].end].endswith(b"/>") else ">"
            yield origin[0].start, origin[0].end, text + closing
        else:
            yield tag.end, tag.end, text + "/>"


def _mjcf(
    content: bytes,
    tags: list[Tag],
    robot: Robot,
    changes: dict[str, tuple[Array, Array]],
) -> Iterator[tuple[int, int, str]]:
    import mujoco

    model, _ = compiled_without_files(robot.path)
    for joint, (turn, shift) in changes.items():
        found = [
            tag
            for tag in tags
            if tag.path[-1] == "joint"
            and tag.path[-2] == "body"
            and tag.attributes.get("name") == joint
        ]
        j = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        body = int(model.jnt_bodyid[j]) if j >= 0 else 0
        if len(found) != 1 or model.body_jntnum[body] != 1 or "frame" in found[0].path:
            raise RobotError(
                f"{robot.path}: joint {joint!r} cannot be moved; valid are named "
                "joints of this very file, one to a body, outside of frames"
            )
        # The joint's frame in its body, as the chain has it at position zero.
        axis, at = model.jnt_axis[j], model.jnt_pos[j]
        reference = float(model.qpos0[model.jnt_qposadr[j]])
        own = rotation_from_axis_angle(axis, -reference)
        if model.jnt_type[j] == mujoco.mjtJoint.mjJNT_SLIDE:
            own, at = np.eye(3), at - reference * axis
        B = Rotation.from_quat(model.body_quat[body], scalar_first=True).as_matrix()
        turned = own @ turn @ own.T
        position = model.body_pos[body] + B @ (at + own @ shift - turned @ at)
        quaternion = Rotation.from_matrix(B @ turned).as_quat(scalar_first=True)
        tag = next(tag for tag in tags if tag.start == found[0].parents[-1])
        text = content[tag.start : tag.end].decode()
        for name in ("pos", *_TURNS):
            text = re.sub(_ATTRIBUTE.format(name), "", text)
        given = f'<body pos="{_text(position)}" quat="{_text(quaternion)}"'
        yield tag.start, tag.end, text.replace("<body", given, 1)


def tags(content: bytes, path: Path) -> Iterator[Tag]:
    """Start tags in the order of the file; undeclared prefixes do not matter."""
    found: list[Tag] = []
    names: list[str] = []
    starts: list[int] = []
    parser = expat.ParserCreate()

    def open_tag(name: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        match = _TAG.match(content, start)
        assert match is not None  # expat has just read it
        names.append(name)
        found.append(
            Tag(tuple(names), tuple(starts), start, match.end(), dict(attributes))
        )
        starts.append(start)

    def close_tag(_: str) -> None:
        names.pop()
        starts.pop()

    parser.StartElementHandler, parser.EndElementHandler = open_tag, close_tag
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise RobotError(f"{path}: not readable XML ({error})") from error
    yield from found


def _roll_pitch_yaw(R: Array) -> Array:
    """Angles about fixed x, y and z; unlike a library's, silent at pitch ±90°."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    roll = np.arctan2(R[2, 1], R[2, 2])
    return np.array([roll, pitch, np.arctan2(R[1, 0], R[0, 0])])


def _numbers(text: str) -> Array:
    return np.array([float(x) for x in text.split()])


def _text(values: Array) -> str:
    return " ".join(repr(float(x)) for x in values)
