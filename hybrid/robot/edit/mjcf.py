"""Edit numbers in an arm's MJCF file; all other bytes stay unchanged."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.actuators import through_gears
from hybrid.robot.build import simulable, spec_text
from hybrid.robot.edit.bodies import changed_bodies
from hybrid.robot.edit.change import Edit, Structure
from hybrid.robot.edit.document import (
    Document,
    Tag,
    element,
    joint_tag,
    model_of,
    relative_path,
)
from hybrid.robot.edit.drives import edit_drives
from hybrid.robot.edit.extra_friction import (
    hard,
    replaced_friction,
    set_couplings,
    set_knee_friction,
    set_passive_motors,
    set_springs,
    set_tendon,
)
from hybrid.robot.mjcf import joint_numbers, mujoco_tree
from hybrid.robot.robot import Robot
from hybrid.robot.tree import Body

_ORIENTATIONS = ("quat", "diaginertia", "axisangle", "euler", "xyaxes", "zaxis")
_LIMITS = ("velocity_limit", "acceleration_limit")
_DEFAULTS = {  # against other values in a default class of the file
    "damping": 0.0, "armature": 0.0, "frictionloss": 0.0, "stiffness": 0.0,
    "limited": "false",
}  # fmt: skip


def edit_mjcf(document: Document, change: Edit, old: Robot) -> tuple[str, ...]:
    """Change an MJCF file.

    Returns:
        Changes that the file cannot express, in words.
    """
    model = model_of(document, old)
    new = change.robot
    turned = new.chain.gravity - old.chain.gravity
    if turned.any():
        given = {"gravity": model.opt.gravity + turned}
        document.set_child(document.root, "option", given)
    tree = mujoco_tree(model, document.where)
    for number, body in changed_bodies(tree, old, new):
        _inertial(document, _body_tag(document, model, number), body)
    replaced = replaced_friction(model, old, new)
    for j in range(new.size):
        _joint(document, model, old, new, j, bool(replaced[j]))
    notes = edit_drives(document, model, new.joints, change.drives)
    if change.structure:
        _structure(document, model, new, change.structure)
    set_couplings(document, model.opt.timestep, old, new)
    set_passive_motors(document, model, old, new)
    set_springs(document, old, new)
    set_knee_friction(document, model.opt.timestep, old, new)
    return notes


def move_assets(document: Document, home: Path, folder: Path) -> None:
    """Adapt the paths of meshes and pictures to another folder."""
    assets = ("mesh", "hfield", "skin", "texture", "flexcomp", "model")
    home, folder = home.resolve(), folder.resolve()
    named = any("file" in t.attributes for t in document.tags if t.path[-1] in assets)
    if home == folder or not named:
        return
    given = _compiler(document)
    both = given.get("assetdir", "")
    new = {
        name: relative_path(given.get(name, both) or ".", home, folder)
        for name in ("meshdir", "texturedir")
    }
    document.set_child(document.root, "compiler", new)
    for tag in document.find("mujoco", "compiler"):
        document.set(tag, {}, drop=("assetdir",))
    for tag in document.tags:
        if tag.path[-1] == "model" and "file" in tag.attributes:
            file = relative_path(tag.attributes["file"], home, folder)
            document.set(tag, {"file": file})


def _body_tag(document: Document, model: Any, number: int) -> Tag:
    """Find the element of a body by its name, its joint or its number."""
    name = model.body(number).name
    bodies = [t for t in document.find("body") if t.path[1] == "worldbody"]
    if name and (found := [t for t in bodies if t.attributes.get("name") == name]):
        return found[0]
    if len(bodies) == model.nbody - 1:
        return bodies[number - 1]
    first = int(model.body_jntadr[number])
    joint = model.joint(first).name if first >= 0 else ""
    for tag in document.find("joint", name=joint) if joint else ():
        around = tag.parent
        while around and around not in bodies:
            around = around.parent
        if around:
            return around
    raise RobotError(
        f"{document.where}: body {name or number} cannot be found; valid are bodies "
        "with names, outside of replicate and attach"
    )


def _inertial(document: Document, tag: Tag, body: Body) -> None:
    mass, center, inertia = simulable(*body)
    six = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    given = {"pos": center, "mass": mass, "fullinertia": six}
    document.set_child(tag, "inertial", given, drop=_ORIENTATIONS)
    for compiler in document.find("mujoco", "compiler", inertiafromgeom="true"):
        document.set(compiler, {"inertiafromgeom": "auto"})


def turn_unit(document: Document, slides: bool) -> float:
    """Factor from radians to the file's unit of angle; 1 for a joint that slides."""
    angle = _compiler(document).get("angle", "degree")
    return 1.0 if slides or angle == "radian" else 180.0 / np.pi


def _compiler(document: Document) -> dict[str, str]:
    """Attributes of all ``compiler`` elements; those of a later one count."""
    found: dict[str, str] = {}
    for tag in document.find("mujoco", "compiler"):
        found |= tag.attributes
    return found


def _joint(
    document: Document, model: Any, old: Robot, new: Robot, j: int, motors: bool
) -> None:
    """Change rotor, friction and spring of a joint, also if its motors are replaced."""
    name, step, given = new.joints[j], model.opt.timestep, dict[str, Any]()
    (dof,) = model.jnt_dofadr[joint_numbers(model, [name])]
    of_drives = {x: through_gears(model, x)[dof] for x in ("armature", "damping")}

    def changed(*fields: str) -> bool:
        return any(getattr(new, x)[j] != getattr(old, x)[j] for x in fields)

    if new.chain.armature[j] != old.chain.armature[j]:
        given["armature"] = new.chain.armature[j] - of_drives["armature"]
    if changed("damping", "quadratic", "cubic"):
        linear = new.damping[j] - of_drives["damping"]
        friction = [linear, new.quadratic[j], new.cubic[j]]
        nonlinear = any(friction[1:]) or old.quadratic[j] or old.cubic[j]
        given["damping"] = friction if nonlinear else linear
    if motors or changed("frictionloss") or bool(old.knee[j]) != bool(new.knee[j]):
        dry = new.frictionloss[j]
        given |= {} if new.knee[j] else {"frictionloss": dry, **hard(step)}
        set_tendon(document, [name], step, frictionloss=dry if new.knee[j] else 0.0)
    if changed("stiffness") or (new.stiffness[j] and changed("springref")):
        unit = turn_unit(document, not new.chain.revolute[j])
        given["stiffness"] = new.stiffness[j]
        given["springref"] = new.springref[j] * unit
    for field, x in of_drives.items():
        if np.min(given.get(field, 0.0)) < 0 and x:
            raise RobotError(
                f"{document.where}: {field} of joint {name!r} is that of its "
                f"actuator, which is more than was found; valid is {field} at the joint"
            )
    if given:
        document.set(joint_tag(document, name), given)


def _structure(
    document: Document, model: Any, robot: Robot, structure: Sequence[Structure]
) -> None:
    """Add the joints, tendons and constraints that functions add to a spec."""
    spec = robot.mujoco_spec()  # each body has one joint
    before = ElementTree.fromstring(spec_text(spec))
    for add in structure:
        add(spec, robot.joints)
    after = ElementTree.fromstring(spec_text(spec))
    added: list[int] = []  # joints with one more behind them
    for body in after.iter("body"):
        joints = body.findall("joint")
        for own in joints[1:]:
            name = joints[0].get("name", "")
            tag, (j,) = joint_tag(document, name), joint_numbers(model, [name])
            unit = turn_unit(document, own.get("type") == "slide")
            given = {**_DEFAULTS, **own.attrib, "pos": model.jnt_pos[j]}
            for key in ("range", "ref", "springref"):
                if key in own.attrib:
                    given[key] = unit * np.array(own.attrib[key].split(), dtype=float)
            document.insert_after(tag, element("joint", given))
            added.append(j)
    known = {child.tag for child in before}
    for section in after:
        if section.tag not in known and section.tag != "default":
            document.append(ElementTree.tostring(section, encoding="unicode").strip())
    _extend_keyframes(document, model, sorted(added, reverse=True))


def _extend_keyframes(document: Document, model: Any, added: Sequence[int]) -> None:
    """Add zeros for new joints to keyframes and to custom limits."""
    places = {"qpos": model.jnt_qposadr, "qvel": model.jnt_dofadr}
    for tag in document.find("keyframe", "key"):
        given = {
            name: " ".join(_extended(tag.attributes[name], at[added].tolist()))
            for name, at in places.items()
            if name in tag.attributes
        }
        document.set(tag, given)
    for tag in document.find("custom", "numeric"):
        if tag.attributes.get("name") in _LIMITS:
            words = _extended(tag.attributes.get("data", ""), added)
            size = {"size": len(words)} if "size" in tag.attributes else {}
            document.set(tag, {"data": " ".join(words), **size})


def _extended(text: str, after: Sequence[int]) -> list[str]:
    """Words with a zero after each of some, last first."""
    words = text.split()
    for place in after:
        words.insert(place + 1, "0")
    return words
