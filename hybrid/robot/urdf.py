"""Read the tree of a URDF file, and the declared properties of an arm in it.

Plain URDF lacks some properties, which are read from the tags of simulators: rotor
inertia and acceleration limits from Drake (``drake:rotor_inertia`` and
``drake:gear_ratio`` of a transmission's actuator, ``drake:acceleration`` of a joint's
limit), springs from Gazebo (``springStiffness`` and ``springReference``).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.names import printable
from hybrid.robot.spatial import INERTIA
from hybrid.robot.tree import Node, Tree, serial_joints

# Types of joints in URDF; those that an arm cannot have are named for messages.
_KINDS = {
    "revolute": "", "continuous": "", "prismatic": "", "fixed": "",
    "floating": "is free", "planar": "is planar",
}  # fmt: skip
SPRING = "springStiffness", "springReference"  # Gazebo's tags
UNLIMITED = 1e16  # of a limit that is none, as SDFormat reads it; some take 0 as it is
_GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s²


def read_urdf(
    content: bytes,
    where: str | Path,
    joints: tuple[str, ...] | None,
    held: Mapping[str, float],
) -> dict[str, Any]:
    """Read the fields of a :class:`~hybrid.robot.robot.Robot` from a URDF file."""
    root = urdf_root(content)
    tree = urdf_tree(root, where)
    keep = serial_joints(tree, joints, held)
    held = tree.held(held)
    found = _named(root, "joint")
    arm = [found[name] for name in keep]

    def of_joints(tag: str, attribute: str) -> Array:
        return np.array([number(x, tag, attribute, 0.0) for x in arm])

    lower, upper = of_joints("limit", "lower"), of_joints("limit", "upper")
    endless = [x.get("type") == "continuous" for x in arm]
    rotors, springs = dict(_rotors(root)), dict(_springs(root))
    spring = np.array([springs.get(name, (0.0, 0.0)) for name in keep])
    armature = np.array([rotors.get(name, 0.0) for name in keep])
    return {
        "name": root.get("name"),
        "chain": tree.chain(keep, held, _GRAVITY, armature),
        "held": held,
        **range_of(lower, upper, endless),
        "v_max": limit(of_joints("limit", "velocity")),
        "a_max": limit(of_joints("limit", "drake:acceleration")),
        "tau_max": limit(of_joints("limit", "effort")),
        "damping": of_joints("dynamics", "damping"),
        "frictionloss": of_joints("dynamics", "friction"),
        "stiffness": spring[:, 0],
        "springref": spring[:, 1],
    }


def urdf_root(content: bytes) -> Element:
    """Parse a URDF file; undeclared prefixes are part of the names."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        text = content.decode(errors="replace")
        reason = "not UTF-8" if text.encode() != content else error
        raise RobotError(f"not a readable URDF ({reason})") from error
    root = builder.close()
    if any("xacro:" in x.tag for x in root.iter()):
        raise RobotError("it is xacro; name it .xacro, or run xacro on it")
    if root.tag != "robot" or not root.get("name"):
        raise RobotError(
            "not a readable URDF; a <robot> with a name, links and joints is needed"
        )
    return root


def urdf_tree(root: Element, where: str | Path) -> Tree:
    """Tree of the links of a URDF file; joints of one link are sorted by name."""
    links = _named(root, "link")
    below: dict[str, list[tuple[Element, str]]] = {name: [] for name in links}
    roots = set(links)  # links without a parent
    for name, joint in sorted(_named(root, "joint").items()):
        parent, child = (_attribute(joint, x, "link") for x in ("parent", "child"))
        for link in (parent, child):
            if link not in links:
                raise RobotError(f"joint {name!r}: there is no link {link!r}")
        if child not in roots:
            raise RobotError(f"link {child!r} is the child of two joints")
        roots.remove(child)
        below[parent].append((joint, child))
    if len(roots) != 1:
        shown = ", ".join(map(repr, sorted(roots))) or "none"
        raise RobotError(f"links without a parent: {shown}; valid is one")
    nodes: list[Node] = []
    todo: list[tuple[int, Element | None, str]] = [(-1, None, roots.pop())]
    while todo:
        before, moved_by, name = todo.pop()
        nodes.append(_node(before, moved_by, links[name]))
        todo += [(len(nodes) - 1, *x) for x in reversed(below[name])]
    if len(nodes) < len(links):
        reached = {node.name for node in nodes}
        looped = next(name for name in links if name not in reached)
        raise RobotError(f"link {looped!r} is in a loop of joints; valid are trees")
    return Tree(str(where), nodes)


def _node(parent: int, joint: Element | None, link: Element) -> Node:
    """Node of a link and the joint before it; the first link has no joint."""
    name = link.get("name", "")
    own: dict[str, Any] = {"parent": parent, "body": name, "name": name}
    if joint is not None:
        own["rotation"], own["translation"] = origin(joint)
        own |= _joint_fields(joint)
    inertial = link.find("inertial")
    if inertial is not None:
        R, own["center"] = origin(inertial)
        own["mass"] = number(inertial, "mass", "value", math.nan)
        names = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")
        six = np.array([number(inertial, "inertia", x, math.nan) for x in names])
        own["inertia"] = R @ six[INERTIA - 4] @ R.T
    return Node(**own)


def _joint_fields(joint: Element) -> dict[str, Any]:
    """Attributes of a node that describe its joint."""
    name, kind = joint.get("name", ""), joint.get("type", "")
    if kind not in _KINDS:
        raise RobotError(
            f"joint {name!r} is of type {printable(kind)!r}; valid are "
            f"{', '.join(_KINDS)}"
        )
    follows = None
    if joint.find("mimic") is not None:
        ratio = number(joint, "mimic", "multiplier", 1.0)
        offset = number(joint, "mimic", "offset", 0.0)
        follows = _attribute(joint, "mimic", "joint"), ratio, offset
    if kind == "fixed":
        return {"follows": follows}
    if kind in ("revolute", "prismatic") and joint.find("limit") is None:
        raise RobotError(f"joint {name!r} is {kind} and has no <limit>")
    axis = numbers(joint, "axis", "xyz", 1.0, 0.0, 0.0)
    if not axis.any():
        raise RobotError(f"axis of joint {name!r} has no direction")
    return {
        "joint": name,
        "kind": _KINDS[kind],
        "follows": follows,
        "axis": axis / np.linalg.norm(axis),
        "revolute": kind != "prismatic",
    }


def origin(element: Element) -> tuple[Array, Array]:
    """Rotation and position from an element's ``origin``, shapes (3, 3) and (3,)."""
    xyz, rpy = (numbers(element, "origin", x, 0.0, 0.0, 0.0) for x in ("xyz", "rpy"))
    return Rotation.from_euler("xyz", rpy).as_matrix(), xyz


def roll_pitch_yaw(R: Array) -> Array:
    """Angles about fixed x, y and z, [rad]; SciPy's would warn at pitch ±90°."""
    pitch = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < 1e-9:
        return np.array([np.arctan2(-R[1, 2], R[1, 1]), pitch, 0.0])
    roll = np.arctan2(R[2, 1], R[2, 2])
    return np.array([roll, pitch, np.arctan2(R[1, 0], R[0, 0])])


def _named(root: Element, tag: str) -> dict[str, Element]:
    """Elements by name; names must be unique."""
    found: dict[str, Element] = {}
    for element in root.iterfind(tag):
        name = element.get("name", "")
        if not name or name in found:
            fault = f"two have the name {name!r}" if name else "one has no name"
            raise RobotError(f"of the elements <{tag}> {fault}")
        found[name] = element
    return found


def _rotors(root: Element) -> Iterator[tuple[str, float]]:
    """Joint and reflected rotor inertia of each transmission with Drake's tags."""
    for drive in root.iter("transmission"):
        actuator = drive.find("actuator")
        if actuator is not None and drive.find("joint") is not None:
            rotor = number(actuator, "drake:rotor_inertia", "value", 0.0)
            ratio = number(actuator, "drake:gear_ratio", "value", 1.0)
            yield _attribute(drive, "joint", "name"), rotor * ratio * ratio


def _springs(root: Element) -> Iterator[tuple[str, tuple[float, float]]]:
    """Joint, and stiffness and rest position, of each spring in Gazebo's tags."""
    for tag in root.iter("gazebo"):
        stiffness, rest = (_number(tag.findtext(x, "0"), x) for x in SPRING)
        if stiffness:
            yield tag.get("reference", ""), (stiffness, rest)


def _attribute(element: Element, tag: str, name: str) -> str:
    inner = element.find(tag)
    text = "" if inner is None else inner.get(name, "")
    if not text:
        raise RobotError(f"{tag} of {_shown(element)} has no {name}")
    return text


def numbers(element: Element, tag: str, name: str, *usual: float) -> Array:
    """Numbers of an attribute in an element's first child with a tag.

    Args:
        element: The element.
        tag: Tag of the child.
        name: Name of the attribute.
        usual: Numbers if the attribute is missing; their count is the valid one.
    """
    inner = element.find(tag)
    text = None if inner is None else inner.get(name)
    if text is None:
        return np.array(usual)
    what = f"{name} of {tag} in {_shown(element)}"
    found = [_number(word, what) for word in text.split()]
    if len(found) != len(usual):
        raise RobotError(f"{what} has {len(found)} numbers; valid are {len(usual)}")
    return np.array(found)


def number(element: Element, tag: str, name: str, usual: float) -> float:
    """Single number of an attribute, as :func:`numbers` reads it."""
    return float(numbers(element, tag, name, usual)[0])


def _number(text: str, what: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise RobotError(
            f"{what} is {printable(text[:40])!r}; valid are finite numbers"
        )
    return number


def _shown(element: Element) -> str:
    return repr(f"{element.tag} {printable(element.get('name', ''))}".strip())


def range_of(lower: Array, upper: Array, endless: Sequence[bool]) -> dict[str, Array]:
    """Position limits; both 0, as exporters of CAD write none, become infinity."""
    none = np.array(endless) | ((lower == 0) & (upper == 0))
    return {
        "q_min": np.where(none, -np.inf, lower), "q_max": np.where(none, np.inf, upper)
    }  # fmt: skip


def limit(values: Array) -> Array:
    """Upper limits; 0, which means "none" in many files, becomes infinity."""
    return np.where((values > 0) & (values < UNLIMITED), values, np.inf)
