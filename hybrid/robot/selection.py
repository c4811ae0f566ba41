"""Which joints of a tree form the arm; the rest is frozen with a warning."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot.chain import MOST_JOINTS


def serial_joints(
    parents: Mapping[str, str | None], joints: tuple[str, ...] | None, path: Path
) -> tuple[str, ...]:
    """Joints of the serial arm in a joint tree, base to tip.

    At a fork the branch with the deepest chain goes on; when two are equally deep
    (the fingers of a gripper) the arm ends there.

    Args:
        parents: Parent joint of each joint, None at the base, in file order.
        joints: Joints the user wants, in any order, or None to choose.
        path: The file, for messages.

    Raises:
        RobotError: No joint, an unknown joint, or joints on different branches.
    """
    if not parents:
        raise RobotError(f"{path}: no movable joint; a serial arm is needed")
    if joints is None:
        kept = _longest_chain(parents)
    else:
        kept = _chosen_chain(parents, joints, path)
    if len(kept) > MOST_JOINTS:
        raise RobotError(f"{path}: {len(kept)} joints; valid are up to {MOST_JOINTS}")
    frozen = [name for name in parents if name not in kept]
    if frozen:
        warnings.warn(
            f"{path.name}: joints {', '.join(frozen)} are not on the arm "
            f"({', '.join(kept)}) and are frozen at zero",
            HybridWarning,
            stacklevel=4,
        )
    return kept


def _longest_chain(parents: Mapping[str, str | None]) -> tuple[str, ...]:
    children: dict[str | None, list[str]] = {}
    for name, parent in parents.items():
        children.setdefault(parent, []).append(name)

    depth: dict[str, int] = {}  # of the longest chain from each joint on
    for name in reversed(list(parents)):  # children stand behind their parents
        below = [depth[child] for child in children.get(name, [])]
        depth[name] = 1 + max(below, default=0)

    chain: list[str] = []
    here = children.get(None, [])
    while here:
        depths = [depth[name] for name in here]
        if len(here) > 1 and depths.count(max(depths)) > 1 and chain:
            break
        chain.append(here[depths.index(max(depths))])
        here = children.get(chain[-1], [])
    return tuple(chain)


def _chosen_chain(
    parents: Mapping[str, str | None], joints: tuple[str, ...], path: Path
) -> tuple[str, ...]:
    unknown = [name for name in joints if name not in parents]
    if unknown or not joints:
        raise RobotError(
            f"{path}: no joint {', '.join(unknown) or 'chosen'}; "
            f"valid are {', '.join(parents)}"
        )

    def ancestors(name: str) -> list[str]:
        line = [name]
        while (parent := parents[line[-1]]) is not None:
            line.append(parent)
        return line[::-1]

    tip = max(joints, key=lambda name: len(ancestors(name)))
    line = ancestors(tip)
    astray = [name for name in joints if name not in line]
    if astray:
        raise RobotError(
            f"{path}: joints {', '.join(astray)} are not on the way to {tip!r}; "
            "the joints of one serial arm are needed"
        )
    return tuple(name for name in line if name in joints)
