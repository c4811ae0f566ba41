"""Select the joints of a tree that form the arm; the others are held."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from hybrid.errors import HybridWarning, RobotError
from hybrid.robot.chain import MOST_JOINTS


@dataclass(frozen=True)
class Tree:
    """Joints of a robot file.

    Attributes:
        where: The file or object, for messages.
        parents: Parent joint of each joint, None at the base, parents first.
        kinds: What the joints are that do not turn or slide along one axis of their
            own; an arm cannot have these.
        coupled: Joints that others follow: an arm ends before them.
    """

    where: str
    parents: Mapping[str, str | None]
    kinds: Mapping[str, str]
    coupled: Collection[str] = ()

    @property
    def free(self) -> list[str]:
        """Joints that an arm can have."""
        return [name for name in self.parents if name not in self.kinds]

    def line(self, name: str, among: Collection[str]) -> list[str]:
        """A joint and its ancestors within a set, base first."""
        line: list[str] = []
        here: str | None = name
        while here is not None and here in among:
            line.append(here)
            here = self.parents[here]
        return line[::-1]


def serial_joints(
    tree: Tree, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> tuple[str, ...]:
    """Joints of the serial arm in a joint tree, base to tip.

    At a fork the branch with the deepest chain goes on, the first of several. Where
    those are no longer than what led there (the fingers of a gripper) the arm ends.

    Args:
        tree: The joints.
        joints: Joints the user wants, in any order, or None to choose.
        held: Positions of joints that are off the arm, [rad or m].

    Raises:
        RobotError: No joint, an unknown joint, joints on different branches, or one
            that an arm cannot have between others.

    Warns:
        HybridWarning: Joints are held, or one of several arms was taken.
    """
    kept = _chosen_chain(tree, joints) if joints is not None else _longest_chain(tree)
    if len(kept) > MOST_JOINTS:
        raise RobotError(
            f"{tree.where}: {len(kept)} joints; valid are up to {MOST_JOINTS}"
        )
    line = tree.line(kept[-1], tree.parents)
    for name in line[line.index(kept[0]) :]:
        if name in tree.kinds:
            raise RobotError(
                f"{tree.where}: joint {name!r} {tree.kinds[name]} and lies within the "
                f"arm ({', '.join(kept)}); choose joints on one side of it"
            )
    still = [name for name in tree.free if name not in kept]
    wrong = [name for name in held if name not in still]
    if wrong:
        raise RobotError(
            f"{tree.where}: cannot hold {', '.join(wrong)}; valid are joints off the "
            f"arm, {', '.join(still) or 'of which there are none'}"
        )
    others = {name for name in tree.parents if name not in kept}
    if others:
        warnings.warn(_said(tree, kept, others, held), HybridWarning, stacklevel=5)
    return kept


def _said(
    tree: Tree, kept: tuple[str, ...], others: set[str], held: Mapping[str, float]
) -> str:
    inner = {tree.parents[name] for name in others}
    ends = [name for name in tree.parents if name in others and name not in inner]
    chains = [tree.line(name, others) for name in ends]
    words = [f"{x[0]} … {x[-1]}" if len(x) > 1 else x[0] for x in chains]
    given = "".join(f", {name} at {x:g}" for name, x in held.items())
    return (
        f"{Path(tree.where).name}: the arm is {', '.join(kept)}; other joints are held "
        f"where the file has them{given} ({'; '.join(words)}); choose others by joints"
    )


def _longest_chain(tree: Tree) -> tuple[str, ...]:
    if not tree.free:
        there = [f"; joint {name!r} {kind}" for name, kind in tree.kinds.items()]
        raise RobotError(
            f"{tree.where}: no movable joint of an arm; valid are joints that turn or "
            f"slide along one axis{''.join(there[:1])}"
        )
    children: dict[str | None, list[str]] = {}
    for name, parent in tree.parents.items():
        children.setdefault(parent, []).append(name)

    depth: dict[str, int] = {}  # of the longest chain from each joint on
    for name in reversed(list(tree.parents)):  # children stand behind their parents
        below = [depth[child] for child in children.get(name, [])]
        depth[name] = (name not in tree.kinds) + max(below, default=0)

    chain: list[str] = []
    here = children.get(None, [])
    while here:
        depths = [depth[name] for name in here]
        if depths.count(deepest := max(depths)) > 1 and deepest <= len(chain):
            break
        name = here[depths.index(deepest)]
        if name not in tree.kinds:
            chain.append(name)
        here = children.get(name, [])
    while len(chain) > 1 and chain[-1] in tree.coupled:
        chain.pop()
    return tuple(chain)


def _chosen_chain(tree: Tree, joints: tuple[str, ...]) -> tuple[str, ...]:
    unknown = [name for name in joints if name not in tree.free]
    if unknown or not joints:
        kinds = [f"; {x} {tree.kinds[x]}" for x in unknown if x in tree.kinds]
        raise RobotError(
            f"{tree.where}: no joint {', '.join(unknown) or 'chosen'}"
            f"{''.join(kinds)}; valid are {', '.join(tree.free)}"
        )
    lines = {name: tree.line(name, tree.parents) for name in joints}
    tip = max(joints, key=lambda name: len(lines[name]))
    astray = [name for name in joints if name not in lines[tip]]
    if astray:
        raise RobotError(
            f"{tree.where}: joints {', '.join(astray)} are not on the way to {tip!r}; "
            "the joints of one serial arm are needed"
        )
    return tuple(name for name in lines[tip] if name in joints)
