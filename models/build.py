"""Write the robot files of this folder from ``arms.yaml``: ``python models/build.py``.

MJCF and URDF come from the same numbers, so that they agree to the last digit; a test
checks that the committed files are what this script writes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import yaml
from numpy.typing import NDArray

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent
COLOURS = {"tube": (0.86, 0.88, 0.90, 1.0), "box": (0.16, 0.33, 0.52, 1.0)}
DRAKE = "https://drake.mit.edu/"  # its URDF tags for what plain URDF has no place for


def arms() -> dict[str, dict[str, Any]]:
    """Content of ``arms.yaml``: one description for each arm name."""
    content: dict[str, dict[str, Any]] = yaml.safe_load(
        (FOLDER / "arms.yaml").read_text(encoding="utf-8")
    )
    return content


def text_of(*values: float) -> str:
    """Numbers as XML text that reads back equal."""
    return " ".join(repr(float(x) + 0.0) for x in values)  # + 0.0: no "-0.0"


def placement(mdh: Sequence[float]) -> tuple[Array, tuple[float, float, float]]:
    """Joint frame in its parent from modified D-H constants a, alpha (degrees), d.

    Returns:
        Position shape (3,) [m], and roll, pitch, yaw [rad].
    """
    a, alpha, d = mdh[0], math.radians(mdh[1]), mdh[2]
    position = np.array([a, -math.sin(alpha) * d, math.cos(alpha) * d])
    return np.round(position, 12), (alpha, 0.0, 0.0)


def inertial(solids: Sequence[dict[str, Any]]) -> tuple[float, Array, Array]:
    """Mass, centre of mass and central inertia of a link made of solids.

    Rounded to 1e-9, so that no machine's last bit shows in the files.

    Returns:
        Mass [kg], centre shape (3,) [m], inertia about it shape (3, 3) [kg·m²].
    """
    parts = [_solid_inertial(solid) for solid in solids]
    mass = sum(m for m, _, _ in parts)
    center = sum(m * c for m, c, _ in parts) / mass
    about = sum(i + m * _steiner(c - center) for m, c, i in parts)
    return round(mass, 9), np.round(center, 9), np.round(about, 9)


def _steiner(x: Array) -> Array:
    return x @ x * np.eye(3) - np.outer(x, x)


def _solid_inertial(solid: dict[str, Any]) -> tuple[float, Array, Array]:
    if "box" in solid:
        center, sides, mass = solid["box"]
        squares = np.square(np.array(sides, dtype=float))
        return mass, np.array(center), mass / 12 * np.diag(squares.sum() - squares)
    start, end, radius, bore, mass = solid["tube"]
    along = np.subtract(end, start).astype(float)
    length = np.linalg.norm(along)
    axis = along / length
    axial = mass / 2 * (radius**2 + bore**2)
    across = mass / 12 * (3 * (radius**2 + bore**2) + length**2)
    inertia = across * np.eye(3) + (axial - across) * np.outer(axis, axis)
    return mass, np.add(start, end) / 2, inertia


def _shape(solid: dict[str, Any]) -> tuple[str, Array, tuple[float, ...], list[float]]:
    """Kind, position, roll-pitch-yaw and sizes (radius, length or sides) of a solid."""
    if "box" in solid:
        center, sides, _ = solid["box"]
        return "box", np.array(center), (0.0, 0.0, 0.0), sides
    start, end, radius, _, _ = solid["tube"]
    x, y, z = np.subtract(end, start)
    length = math.sqrt(x * x + y * y + z * z)
    turn = (0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x))
    middle = np.round(np.add(start, end) / 2, 12)
    return "cylinder", middle, turn, [radius, round(length, 12)]


def _armature(joint: dict[str, Any]) -> float:
    return float(round(joint["rotor"] * joint["ratio"] ** 2, 12))


def mjcf(name: str, arm: dict[str, Any]) -> str:
    """The arm as an MJCF document."""
    root = ET.Element("mujoco", model=name)
    root.append(ET.Comment(f" {arm['about']}; written by build.py from arms.yaml "))
    ET.SubElement(root, "compiler", angle="radian", eulerseq="XYZ")
    ET.SubElement(root, "option", timestep="0.001", integrator="implicitfast")
    joints = arm["joints"]
    custom = ET.SubElement(root, "custom")
    for kind in ("velocity", "acceleration"):
        limits = text_of(*(math.radians(j[kind]) for j in joints))
        ET.SubElement(custom, "numeric", name=f"{kind}_limit", data=limits)
    body = ET.SubElement(ET.SubElement(root, "worldbody"), "body")
    _mjcf_link(body, arm["base"])
    contact = ET.SubElement(root, "contact")
    actuator = ET.SubElement(root, "actuator")
    parent = arm["base"]["link"]
    for joint in joints:
        position, turn = placement(joint["mdh"])
        body = ET.SubElement(body, "body", pos=text_of(*position), euler=text_of(*turn))
        _mjcf_link(body, joint)
        # Adjacent links overlap where their housings meet.
        ET.SubElement(contact, "exclude", body1=parent, body2=joint["link"])
        rated = text_of(-joint["torque"], joint["torque"])
        motor = {"name": joint["name"], "joint": joint["name"]}
        ET.SubElement(actuator, "motor", motor, ctrlrange=rated, forcerange=rated)
        parent = joint["link"]
    ET.SubElement(body, "site", name="flange", pos=text_of(*arm["flange"]))
    home = text_of(*(math.radians(x) for x in arm["home"]))
    ET.SubElement(ET.SubElement(root, "keyframe"), "key", name="home", qpos=home)
    return _document(root)


def _mjcf_link(body: ET.Element, link: dict[str, Any]) -> None:
    body.set("name", link["link"])
    mass, center, about = inertial(link["solids"])
    upper = about[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ET.SubElement(
        body,
        "inertial",
        pos=text_of(*center),
        mass=text_of(mass),
        fullinertia=text_of(*upper),
    )
    if "mdh" in link:
        ET.SubElement(
            body,
            "joint",
            name=link["name"],
            axis="0 0 1",
            range=text_of(*(math.radians(x) for x in link["range"])),
            armature=text_of(_armature(link)),
            damping=text_of(link["damping"]),
            frictionloss=text_of(link["frictionloss"]),
        )
    for number, solid in enumerate(link["solids"], start=1):
        kind, position, turn, sizes = _shape(solid)
        if kind == "cylinder":
            sizes = [sizes[0], sizes[1] / 2]
        else:
            sizes = [side / 2 for side in sizes]
        ET.SubElement(
            body,
            "geom",
            name=f"{link['link']}_{number}",
            type=kind,
            pos=text_of(*position),
            euler=text_of(*turn),
            size=text_of(*sizes),
            rgba=text_of(*COLOURS["box" if kind == "box" else "tube"]),
        )


def urdf(name: str, arm: dict[str, Any]) -> str:
    """The arm as a URDF document, rotors and accelerations in Drake's tags."""
    root = ET.Element("robot", {"name": name, "xmlns:drake": DRAKE})
    root.append(ET.Comment(f" {arm['about']}; written by build.py from arms.yaml "))
    for kind, colour in COLOURS.items():
        material = ET.SubElement(root, "material", name=kind)
        ET.SubElement(material, "color", rgba=text_of(*colour))
    _urdf_link(root, arm["base"])
    parent = arm["base"]["link"]
    for joint in arm["joints"]:
        _urdf_link(root, joint)
        _urdf_joint(root, joint, parent)
        parent = joint["link"]
    ET.SubElement(root, "link", name="flange")
    fixed = ET.SubElement(root, "joint", name="flange_mount", type="fixed")
    ET.SubElement(fixed, "origin", xyz=text_of(*arm["flange"]), rpy=text_of(0, 0, 0))
    ET.SubElement(fixed, "parent", link=parent)
    ET.SubElement(fixed, "child", link="flange")
    for joint in arm["joints"]:
        drive = ET.SubElement(root, "transmission", name=f"{joint['name']}_drive")
        form = ET.SubElement(drive, "type")
        form.text = "transmission_interface/SimpleTransmission"
        ET.SubElement(drive, "joint", name=joint["name"])
        actuator = ET.SubElement(drive, "actuator", name=joint["name"])
        ET.SubElement(actuator, "drake:rotor_inertia", value=text_of(joint["rotor"]))
        ET.SubElement(actuator, "drake:gear_ratio", value=text_of(joint["ratio"]))
    return _document(root)


def _urdf_link(root: ET.Element, link: dict[str, Any]) -> None:
    element = ET.SubElement(root, "link", name=link["link"])
    mass, center, about = inertial(link["solids"])
    inertia = ET.SubElement(element, "inertial")
    ET.SubElement(inertia, "origin", xyz=text_of(*center), rpy=text_of(0, 0, 0))
    ET.SubElement(inertia, "mass", value=text_of(mass))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    upper = about[np.triu_indices(3)]
    tensor = {n: text_of(x) for n, x in zip(names, upper, strict=True)}
    ET.SubElement(inertia, "inertia", tensor)
    for role in ("visual", "collision"):
        for number, solid in enumerate(link["solids"], start=1):
            kind, position, turn, sizes = _shape(solid)
            part = ET.SubElement(element, role, name=f"{link['link']}_{number}")
            ET.SubElement(part, "origin", xyz=text_of(*position), rpy=text_of(*turn))
            shape = ET.SubElement(part, "geometry")
            if kind == "box":
                ET.SubElement(shape, "box", size=text_of(*sizes))
            else:
                radius, length = (text_of(x) for x in sizes)
                ET.SubElement(shape, "cylinder", radius=radius, length=length)
            if role == "visual":
                material = "box" if kind == "box" else "tube"
                ET.SubElement(part, "material", name=material)


def _urdf_joint(root: ET.Element, joint: dict[str, Any], parent: str) -> None:
    position, turn = placement(joint["mdh"])
    element = ET.SubElement(root, "joint", name=joint["name"], type="revolute")
    ET.SubElement(element, "origin", xyz=text_of(*position), rpy=text_of(*turn))
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=joint["link"])
    ET.SubElement(element, "axis", xyz="0 0 1")
    lower, upper = (text_of(math.radians(x)) for x in joint["range"])
    limits = {
        "lower": lower,
        "upper": upper,
        "effort": text_of(joint["torque"]),
        "velocity": text_of(math.radians(joint["velocity"])),
        "drake:acceleration": text_of(math.radians(joint["acceleration"])),
    }
    ET.SubElement(element, "limit", limits)
    damping, friction = text_of(joint["damping"]), text_of(joint["frictionloss"])
    ET.SubElement(element, "dynamics", damping=damping, friction=friction)


def _document(root: ET.Element) -> str:
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def documents() -> dict[str, str]:
    """Text of every robot file by file name."""
    texts = {}
    for name, arm in arms().items():
        texts[f"{name}.xml"] = mjcf(name, arm)
        texts[f"{name}.urdf"] = urdf(name, arm)
    return texts


if __name__ == "__main__":
    for file_name, document in documents().items():
        (FOLDER / file_name).write_text(document, encoding="utf-8")
