"""The bodies of a robot file that make up each link of the arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.mjcf import joint_names, start
from hybrid.robot.robot import Robot
from hybrid.robot.spatial import central_inertia, inertia_fault, inertial_about
from hybrid.robot.urdf import start as urdf_start

_SAME = 1e-9  # of a link's parameters: what rounding makes of them
_HALVINGS = 40


@dataclass(frozen=True)
class Part:
    """A body that moves with a link.

    Attributes:
        body: Its number in MuJoCo's model, or its name in a URDF file.
        link: The link, counted from 0.
        own: Whether it is the body that the link's joint moves.
        rotation: Turn of its frame in that of the link, shape (3, 3).
        position: Place of its frame in that of the link, shape (3,), [m].
        inertial: Its ten parameters in the frame of the link, shape (10,).
    """

    body: Any
    link: int
    own: bool
    rotation: Array
    position: Array
    inertial: Array

    @property
    def central(self) -> tuple[float, Array, Array]:
        """Mass, centre of mass, and inertia about it, in its own frame."""
        mass, center, about = central_inertia(self.inertial)
        R = self.rotation
        return mass, R.T @ (center - self.position), R.T @ about @ R


def mjcf_parts(robot: Robot, model: Any) -> list[Part]:
    """Bodies of MuJoCo's model of the arm's file."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[:] = start(model, robot.held)
    mujoco.mj_kinematics(model, data)
    names = joint_names(model)
    moved = {
        int(model.jnt_bodyid[names.index(x)]): k for k, x in enumerate(robot.joints)
    }
    link, parts = {0: -1}, list[Part]()
    for body in range(1, model.nbody):
        k = link[body] = moved.get(body, link[int(model.body_parentid[body])])
        if k < 0:
            continue
        joint = names.index(robot.joints[k])
        home = data.xmat[model.jnt_bodyid[joint]].reshape(3, 3)
        anchor = data.xanchor[joint]
        R = home.T @ data.xmat[body].reshape(3, 3)
        turned = home.T @ data.ximat[body].reshape(3, 3)
        inertial = inertial_about(
            model.body_mass[body],
            home.T @ (data.xipos[body] - anchor),
            turned @ np.diag(model.body_inertia[body]) @ turned.T,
        )
        position = home.T @ (data.xpos[body] - anchor)
        parts.append(Part(body, k, body in moved, R, position, inertial))
    return parts


def urdf_parts(robot: Robot, text: str) -> list[Part]:
    """Links of a URDF file that has the arm, by the file's text."""
    import pinocchio as pin

    model = pin.buildModelFromXML(text)
    data = model.createData()
    pin.forwardKinematics(model, data, urdf_start(model, robot.held))
    pin.updateFramePlacements(model, data)
    index = {model.getJointId(name): k for k, name in enumerate(robot.joints)}
    link, parts = {0: -1}, list[Part]()
    for j in range(1, model.njoints):
        link[j] = index.get(j, link[model.parents[j]])
    home = {k: data.oMi[j] for j, k in index.items()}
    for f, frame in enumerate(model.frames):
        k = link[frame.parentJoint]
        if frame.type != pin.FrameType.BODY or k < 0:
            continue
        pose = home[k].actInv(data.oMf[f])
        # That of a body held by another is kept at the fixed joint between them.
        inertia = model.frames[frame.parentFrame].inertia
        inertial = pose.act(inertia).toDynamicParameters()
        own = frame.parentJoint in index and frame.placement.isIdentity(1e-12)
        own = own and not any(p.own and p.link == k for p in parts)
        R, p = np.array(pose.rotation), np.array(pose.translation)
        parts.append(Part(frame.name, k, own, R, p, np.array(inertial)))
    return parts


def changed_parts(parts: Sequence[Part], old: Robot, new: Robot) -> Iterator[Part]:
    """Bodies whose parameters change with those of the links.

    The body that the joint moves takes the change. Where that would leave no body that
    could be built, the others of the link become lighter, all by the same factor.

    Raises:
        RobotError: No body of the file can hold the parameters of a link.
    """
    for k in range(new.size):
        before, goal = old.chain.inertial[k], new.chain.inertial[k]
        if (np.abs(goal - before) <= _SAME * np.abs(before).max()).all():
            continue
        own = [p for p in parts if p.link == k and p.own]
        others = [p for p in parts if p.link == k and not p.own]
        if not own:
            raise RobotError(
                f"{new.path}: joint {new.joints[k]!r} moves no body of its own, whose "
                "inertia could be set"
            )
        rest = sum((p.inertial for p in others), np.zeros(10))
        for share in (*(0.5**i for i in range(_HALVINGS)), 0.0):
            main = goal - share * rest
            mass, _, about = central_inertia(main)
            if mass > 0 and not inertia_fault(mass, about):
                break
        yield replace(own[0], inertial=main)
        if share < 1.0:
            yield from (replace(p, inertial=share * p.inertial) for p in others)
