"""New parameters for the bodies of a robot file that together form a link."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.robot import Robot
from hybrid.robot.spatial import central_inertia, inertia_fault
from hybrid.robot.tree import Body, Place, Tree

_SAME = 1e-9  # of a link's parameters, the rounding error
_HALVINGS = 40  # of the share of other bodies, before it becomes zero


def changed_bodies(tree: Tree, old: Robot, new: Robot) -> Iterator[tuple[Any, Body]]:
    """Bodies with new parameters, so that the links have those of the new arm.

    The body that the joint moves directly takes the change. If its parameters would not
    be physical, the other bodies of the link are scaled down by a common factor.

    Yields:
        See :attr:`.Node.body`, and mass, centre and inertia in the body's own frame.
    """
    places, _ = tree.places(old.joints, old.held)
    members: list[list[tuple[Any, Place, np.ndarray]]] = [[] for _ in new.joints]
    for node, place in places:
        if place.link >= 0 and node.body is not None:
            members[place.link].append((node.body, place, place.inertial(node)))
    for k, goal in enumerate(new.chain.inertial):
        before = old.chain.inertial[k]
        if (np.abs(goal - before) <= _SAME * np.abs(before).max()).all():
            continue
        if not members[k]:
            raise RobotError(
                f"{new.path}: joint {new.joints[k]!r} moves no body of its own, whose "
                "inertia could be set"
            )
        (main, place, _), *others = members[k]
        rest = sum((inertial for _, _, inertial in others), np.zeros(10))
        for share in (*(0.5**i for i in range(_HALVINGS)), 0.0):
            own = goal - share * rest
            mass, _, about = central_inertia(own)
            if mass > 0 and not inertia_fault(mass, about):
                break
        yield main, _in_frame(place, own)
        for body, place, inertial in others if share < 1.0 else ():
            yield body, _in_frame(place, share * inertial)


def _in_frame(place: Place, inertial: np.ndarray) -> Body:
    """Mass, centre of mass and central inertia in a frame that is fixed to the link."""
    mass, center, about = central_inertia(inertial)
    R = place.rotation
    return mass, R.T @ (center - place.position), R.T @ about @ R
