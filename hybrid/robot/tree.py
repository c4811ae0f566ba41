"""The tree of a robot file: frames, joints and bodies, the same for all formats."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.errors import RobotError, warn
from hybrid.robot.chain import MOST_JOINTS, Chain
from hybrid.robot.spatial import central_inertia, inertia_fault, inertial_about

_BASE = -1
_ROUNDING = 1e-14  # error of a central inertia, of that about the joint
Body = tuple[float, Array, Array]  # mass, centre (3,), inertia about it (3, 3)


@dataclass(frozen=True)
class Node:
    """A frame, which is fixed to its parent frame or moved by a joint, and its body.

    Attributes:
        parent: Index of the parent frame, −1 for the world.
        rotation: Rotation in the parent with the joint at zero, shape (3, 3).
        translation: Position in the parent, shape (3,), [m].
        joint: Name of the joint, empty if the frame is fixed.
        kind: Kind of a joint that an arm cannot have; empty for a hinge or slide.
        follows: Joint that this joint follows, ratio and offset (mimic), or None.
        axis: Unit axis of the joint, shape (3,).
        revolute: Whether the joint rotates about its axis.
        home: Position of the joint in the file, [rad or m].
        body: The body with this frame: its number in MuJoCo's model, or its name in a
            URDF file; None without a body.
        name: Name of the body, for messages.
        mass: Mass of the body, [kg].
        center: Centre of mass, shape (3,), [m].
        inertia: Inertia about the centre of mass, shape (3, 3), [kg·m²].
    """

    parent: int
    rotation: Array = field(default_factory=lambda: np.eye(3))
    translation: Array = field(default_factory=lambda: np.zeros(3))
    joint: str = ""
    kind: str = ""
    follows: tuple[str, float, float] | None = None
    axis: Array = field(default_factory=lambda: np.zeros(3))
    revolute: bool = True
    home: float = 0.0
    body: Any = None
    name: str = ""
    mass: float = 0.0
    center: Array = field(default_factory=lambda: np.zeros(3))
    inertia: Array = field(default_factory=lambda: np.zeros((3, 3)))


class Place(NamedTuple):
    """Link of the arm that a frame is fixed to, and the frame's pose in it.

    Attributes:
        link: Index of the link from 0; −1 is the base, whose frame is the world's.
        rotation: Rotation in the link, shape (3, 3).
        position: Position in the link, shape (3,), [m].
    """

    link: int
    rotation: Array
    position: Array

    def inertial(self, node: Node) -> Array:
        """Ten parameters of a frame's body, in the frame of the link."""
        R = self.rotation
        center = self.position + R @ node.center
        return inertial_about(node.mass, center, R @ node.inertia @ R.T)


@dataclass(frozen=True)
class Tree:
    """Frames of a robot file.

    Attributes:
        where: The file or object, for messages.
        nodes: The frames, parents first.
    """

    where: str
    nodes: Sequence[Node]

    @cached_property
    def parents(self) -> Mapping[str, str | None]:
        """Parent joint of each joint, None at the base, parents first."""
        last: list[str | None] = []  # joint that moves each frame
        parents: dict[str, str | None] = {}
        for node in self.nodes:
            above = last[node.parent] if node.parent >= 0 else None
            if node.joint:
                parents[node.joint] = above
            last.append(node.joint or above)
        return parents

    @cached_property
    def kinds(self) -> Mapping[str, str]:
        """Kind of each joint that an arm cannot have."""
        follow = {x: f"follows joint {y!r} (mimic)" for x, y in self.leaders.items()}
        kinds = {x.joint: follow.get(x.joint, x.kind) for x in self.nodes}
        return {name: kind for name, kind in kinds.items() if kind}

    @cached_property
    def leaders(self) -> Mapping[str, str]:
        """Leading joint of each joint that follows one (mimic).

        A fixed joint that would follow has the name of its link.
        """
        return {x.joint or x.name: x.follows[0] for x in self.nodes if x.follows}

    @property
    def free(self) -> list[str]:
        """Joints that an arm can have."""
        return [name for name in self.parents if name not in self.kinds]

    def line(self, name: str, among: Collection[str]) -> list[str]:
        """Joint and its ancestors within a set, base first."""
        line: list[str] = []
        here: str | None = name
        while here is not None and here in among:
            line.append(here)
            here = self.parents[here]
        return line[::-1]

    def held(self, held: Mapping[str, float]) -> dict[str, float]:
        """Positions of held joints, and of those that follow them."""
        moved = {
            node.joint: node.follows[1] * held.get(node.follows[0], 0.0)
            + node.follows[2]
            for node in self.nodes
            if node.follows
        }
        return {name: x for name, x in moved.items() if x} | dict(held)

    def places(
        self, joints: Sequence[str], held: Mapping[str, float]
    ) -> tuple[list[tuple[Node, Place]], list[Place]]:
        """Nodes with their places, and places of joints' frames in the link before.

        The arm's joints are given base to tip, and the positions of the others if they
        differ from the file.
        """
        places: list[tuple[Node, Place]] = []
        frames: list[Place] = []
        for node in self.nodes:
            link, R, p = Place(_BASE, np.eye(3), np.zeros(3))
            if node.parent >= 0:
                _, (link, R, p) = places[node.parent]
            p, R = p + R @ node.translation, R @ node.rotation
            at = held.get(node.joint, node.home)
            if node.joint in joints:
                frames.append(Place(link, R, p))
                link, R, p = len(frames) - 1, np.eye(3), np.zeros(3)
            elif node.joint and node.revolute:
                R = R @ Rotation.from_rotvec(at * node.axis).as_matrix()
            elif node.joint:
                p = p + at * (R @ node.axis)
            places.append((node, Place(link, R, p)))
        return places, frames

    def chain(
        self,
        joints: Sequence[str],
        held: Mapping[str, float],
        gravity: Array,
        armature: Array,
    ) -> Chain:
        """Chain of an arm; bodies on held joints are part of its links."""
        places, frames = self.places(joints, held)
        inertial = np.zeros((len(joints), 10))
        names: dict[int, str] = {}  # of links with a body
        for node, place in places:
            if place.link >= 0 and node.body is not None:
                inertial[place.link] += place.inertial(node)
                names.setdefault(place.link, node.name)
        for k, name in sorted(names.items()):
            _check_link(name, inertial[k])
        moved = {node.joint: node for node in self.nodes if node.joint}
        return Chain(
            joints=tuple(joints),
            rotation=np.array([x.rotation for x in frames]),
            translation=np.array([x.position for x in frames]),
            axis=np.array([moved[x].axis for x in joints]),
            revolute=np.array([moved[x].revolute for x in joints]),
            inertial=inertial,
            gravity=gravity,
            armature=armature,
        )


def _check_link(name: str, inertial: Array) -> None:
    if not inertial.any():
        raise RobotError(
            f"link {name!r} moves and has no inertia; give it an <inertial>, or choose "
            "joints without it"
        )
    mass, _, about = central_inertia(inertial)
    rounding = _ROUNDING * np.abs(inertial[4:]).max()
    about = np.where(np.abs(about) < rounding, 0.0, about)
    if fault := inertia_fault(mass, about):
        raise RobotError(f"link {name!r} {fault}")


def serial_joints(
    tree: Tree, joints: tuple[str, ...] | None, held: Mapping[str, float]
) -> tuple[str, ...]:
    """Choose the joints of the serial arm in a tree, base to tip.

    They are those that the user wants, in any order. Otherwise the arm goes on at a
    fork with the branch of the longest chain, the first of equal ones. It ends if equal
    branches are not longer than the chain before the fork, as the fingers of a gripper
    are. The other joints are held, where the user wants or the file has them.

    Raises:
        RobotError: There is no joint, an unknown joint, joints on different branches,
            or a joint between others that an arm cannot have.

    Warns:
        HybridWarning: Joints are held, or the first of several arms was chosen.
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
    for follower, leader in tree.leaders.items():
        if leader in kept:
            raise RobotError(
                f"{follower!r} follows joint {leader!r} of the arm (mimic), "
                "which moves both; choose joints without it"
            )
    others = {name for name in tree.parents if name not in kept}
    if others:
        warn(_choice(tree, kept, others, held))
    return kept


def _choice(
    tree: Tree, kept: tuple[str, ...], others: set[str], held: Mapping[str, float]
) -> str:
    """Warning that lists the joints of the arm and the joints that are held."""
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
        others = [f"; joint {name!r} {kind}" for name, kind in tree.kinds.items()]
        raise RobotError(
            f"{tree.where}: no movable joint of an arm; valid are joints that turn or "
            f"slide along one axis{''.join(others[:1])}"
        )
    children: dict[str | None, list[str]] = {None: [], **{x: [] for x in tree.parents}}
    depth = dict.fromkeys(children, 0)  # length of the longest chain from each joint
    for name, parent in reversed(list(tree.parents.items())):  # children first
        depth[name] += name not in tree.kinds
        depth[parent] = max(depth[parent], depth[name])
        children[parent].insert(0, name)
    chain: list[str] = []
    here = children[None]
    while here:
        depths = [depth[name] for name in here]
        if depths.count(deepest := max(depths)) > 1 and deepest <= len(chain):
            break
        name = here[depths.index(deepest)]
        if name not in tree.kinds:
            chain.append(name)
        here = children[name]
    while len(chain) > 1 and chain[-1] in tree.leaders.values():
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
    line = max((tree.line(name, tree.parents) for name in joints), key=len)
    if elsewhere := [name for name in joints if name not in line]:
        raise RobotError(
            f"{tree.where}: joints {', '.join(elsewhere)} are not on the way "
            f"to {line[-1]!r}; the joints of one serial arm are needed"
        )
    return tuple(name for name in line if name in joints)
