"""The bodies of a robot file that together form each link of the arm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot.robot import Robot
from hybrid.robot.spatial import central_inertia, inertia_fault, inertial_about
from hybrid.robot.tree import Tree

_SAME = 1e-9  # of a link's parameters, the rounding error
_HALVINGS = 40  # of the share of other bodies, before it becomes zero


@dataclass(frozen=True)
class Part:
    """A body that moves with a link.

    Attributes:
        body: Its number in MuJoCo's model, or its name in a URDF file.
        link: The link, counted from 0.
        own: Whether the link's joint moves this body directly.
        rotation: Rotation of its frame in the link, shape (3, 3).
        position: Position of its frame in the link, shape (3,), [m].
        inertial: Inertial parameters in the frame of the link, shape (10,).
    """

    body: Any
    link: int
    own: bool
    rotation: Array
    position: Array
    inertial: Array

    @property
    def central(self) -> tuple[float, Array, Array]:
        """Mass, centre of mass and central inertia in the frame of the body."""
        mass, center, about = central_inertia(self.inertial)
        R = self.rotation
        return mass, R.T @ (center - self.position), R.T @ about @ R


def parts_of(robot: Robot, tree: Tree) -> list[Part]:
    """Find the bodies of a file that move with the links of an arm."""
    places, _ = tree.places(robot.joints, robot.held)
    parts: list[Part] = []
    for node, place in zip(tree.nodes, places, strict=True):
        if place.link >= 0 and node.body is not None:
            link, R, p = place
            own = all(part.link != link for part in parts)
            inertial = inertial_about(*place.body(node))
            parts.append(Part(node.body, link, own, R, p, inertial))
    return parts


def changed_parts(parts: Sequence[Part], old: Robot, new: Robot) -> Iterator[Part]:
    """Bodies with new parameters, so that the links have those of the new arm.

    The body that the joint moves directly takes the change. If its parameters would not
    be physical, the other bodies of the link are scaled down by a common factor.
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
