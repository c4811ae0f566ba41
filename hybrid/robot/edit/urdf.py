"""Edit numbers in an arm's URDF file; all other bytes stay unchanged."""

from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.edit.bodies import changed_bodies
from hybrid.robot.edit.change import Edit
from hybrid.robot.edit.document import Document, Tag, element, relative_path, text_of
from hybrid.robot.robot import Robot
from hybrid.robot.tree import Body
from hybrid.robot.urdf import SPRING, urdf_root, urdf_tree

DRAKE = {"xmlns:drake": "http://drake.mit.edu"}


def edit_urdf(document: Document, change: Edit, old: Robot) -> tuple[str, ...]:
    """Change a URDF file.

    Returns:
        Changes that the file cannot express, in words.
    """
    new = change.robot
    tree = urdf_tree(urdf_root(document.content), document.where)
    for name, body in changed_bodies(tree, old, new):
        (link,) = document.find("robot", "link", name=name)
        _inertial(document, link, body)
    for j, name in enumerate(new.joints):
        (joint,) = document.find("robot", "joint", name=name)
        given = {
            word: getattr(new, field)[j]
            for word, field in (("damping", "damping"), ("friction", "frictionloss"))
            if getattr(new, field)[j] != getattr(old, field)[j]
        }
        if given:
            document.set_child(joint, "dynamics", given)
        if new.chain.armature[j] != old.chain.armature[j]:
            _rotor(document, name, float(new.chain.armature[j]))
        spring, before = ((x.stiffness[j], x.springref[j]) for x in (new, old))
        if spring != before:
            _spring(document, name, *map(float, spring))
    if np.abs(new.chain.gravity - old.chain.gravity).max() > 1e-6:
        return (f"gravity {text_of(new.chain.gravity)} m/s²",)
    return ()


def move_meshes(document: Document, home: Path, folder: Path) -> None:
    """Adapt the paths of meshes and pictures to another folder."""
    home, folder = home.resolve(), folder.resolve()
    for tag in document.tags:
        file = tag.attributes.get("filename", "")
        if home != folder and tag.path[-1] in ("mesh", "texture"):
            document.set(tag, {"filename": relative_path(file, home, folder)})


def inertial_text(mass: float, center: Array, about: Array) -> str:
    """An ``inertial`` element, in the frame of its link."""
    parts = _inertial_parts(mass, center, about)
    inner = "".join(element(name, x) for name, x in parts.items())
    return f"<inertial>{inner}</inertial>"


def _inertial_parts(
    mass: float, center: Array, about: Array
) -> dict[str, dict[str, object]]:
    six = {f"i{'xyz'[r]}{'xyz'[c]}": about[r, c] for r in range(3) for c in range(r, 3)}
    origin = {"xyz": center, "rpy": "0 0 0"}
    return {"origin": origin, "mass": {"value": mass}, "inertia": six}


def _inertial(document: Document, link: Tag, body: Body) -> None:
    own = document.children(link, "inertial")
    for inertial in own:
        for name, given in _inertial_parts(*body).items():
            document.set_child(inertial, name, given)
    if not own:
        document.insert_child(link, inertial_text(*body))


def _rotor(document: Document, joint: str, inertia: float) -> None:
    """Write a rotor to the drive of a joint, or to a new one, as Drake reads it."""
    for drive in document.find("transmission"):
        moved = document.children(drive, "joint")[:1]
        if [x.attributes.get("name") for x in moved] != [joint]:
            continue
        for motor in document.children(drive, "actuator"):
            gear = document.children(motor, "drake:gear_ratio")
            ratio = float(gear[0].attributes.get("value", "1")) if gear else 1.0
            if not document.children(motor, "drake:rotor_inertia"):
                _declare(document)
            given = {"value": inertia / ratio**2}
            document.set_child(motor, "drake:rotor_inertia", given)
            return
    _declare(document)
    name, own = text_of(joint), element("drake:rotor_inertia", {"value": inertia})
    document.append(
        f'<transmission name="{name}_drive"><type>SimpleTransmission</type>'
        f'<joint name="{name}"/><actuator name="{name}_motor">{own}</actuator>'
        "</transmission>"
    )


def _spring(document: Document, joint: str, stiffness: float, rest: float) -> None:
    """Write the spring of a joint in Gazebo's tags, in place of those in the file."""
    own = document.find("gazebo", reference=joint)
    for tag in own:
        for name in SPRING:
            for child in document.children(tag, name):
                document.replace(child, "")
    if not stiffness:
        return
    values = zip(SPRING, (stiffness, rest), strict=True)
    text = "".join(f"<{name}>{text_of(x)}</{name}>" for name, x in values)
    if own:
        document.insert_child(own[-1], text)
    else:
        document.append(f'<gazebo reference="{text_of(joint)}">{text}</gazebo>')


def _declare(document: Document) -> None:
    if not DRAKE.keys() <= document.root.attributes.keys():
        document.set(document.root, DRAKE)
