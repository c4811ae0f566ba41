"""Change the joint placements of a robot file; all other bytes stay unchanged."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.files import atomic_path
from hybrid.robot.chain import Chain
from hybrid.robot.edit.document import Document
from hybrid.robot.mjcf import joint_frame, matrix
from hybrid.robot.mujoco_model import compile_without_assets
from hybrid.robot.read import URDF
from hybrid.robot.urdf import origin, roll_pitch_yaw, urdf_root

if TYPE_CHECKING:
    from hybrid.robot.robot import Robot

_ORIENTATIONS = ("axisangle", "euler", "xyaxes", "zaxis")
_UNMOVED = 1e-12  # m or rad; a smaller change is not written


def write_placements(robot: Robot, chain: Chain, path: str | Path) -> None:
    """Write a copy of the robot's file with the joint placements of another chain.

    Raises:
        RobotError: The file is missing, or cannot express a joint's placement.
    """
    document = Document.load(robot.path)
    changes = _changes(robot.chain, chain)
    if Path(robot.path).suffix.lower() in URDF:
        _edit_urdf(document, changes)
    else:
        _edit_mjcf(document, robot, changes)
    with atomic_path(path) as temporary:
        temporary.write_bytes(document.edited())


def _changes(old: Chain, new: Chain) -> dict[str, tuple[Array, Array]]:
    """Rotation and shift of each moved joint frame, in the old frame."""
    changes = {}
    for k, joint in enumerate(old.joints):
        turn = old.rotation[k].T @ new.rotation[k]
        shift = old.rotation[k].T @ (new.translation[k] - old.translation[k])
        if max(abs(turn - np.eye(3)).max(), abs(shift).max()) > _UNMOVED:
            changes[joint] = (turn, shift)
    return changes


def _edit_urdf(document: Document, changes: dict[str, tuple[Array, Array]]) -> None:
    for joint in urdf_root(document.content).iterfind("joint"):
        name = joint.get("name", "")
        if name in changes:
            (R, xyz), (turn, shift) = origin(joint), changes[name]
            (tag,) = document.find("robot", "joint", name=name)
            given = {"xyz": xyz + R @ shift, "rpy": roll_pitch_yaw(R @ turn)}
            document.set_child(tag, "origin", given)


def _edit_mjcf(
    document: Document, robot: Robot, changes: dict[str, tuple[Array, Array]]
) -> None:
    model, _ = compile_without_assets(robot.path)
    for joint, (turn, shift) in changes.items():
        found = document.find("body", "joint", name=joint)
        j = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        body = int(model.jnt_bodyid[j]) if j >= 0 else 0
        if len(found) != 1 or model.body_jntnum[body] != 1 or "frame" in found[0].path:
            raise RobotError(
                f"{robot.path}: joint {joint!r} cannot be moved; valid are named "
                "joints of this very file, one to a body, outside of frames"
            )
        # The joint's frame in its body at position zero.
        own, at, _ = joint_frame(model, j, np.eye(3), np.zeros(3))
        B = matrix(model.body_quat[body])
        turned = own @ turn @ own.T
        position = model.body_pos[body] + B @ (at + own @ shift - turned @ at)
        quaternion = Rotation.from_matrix(B @ turned).as_quat(scalar_first=True)
        around = found[0].parent
        assert around is not None  # the body
        document.set(around, {"pos": position, "quat": quaternion}, drop=_ORIENTATIONS)
