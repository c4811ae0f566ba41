"""A model as a robot file: what MJCF or URDF can say, and what it cannot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.effects import Effect
from hybrid.effects.instant import FIELDS
from hybrid.errors import HybridError
from hybrid.model.dynamic_model import DynamicModel
from hybrid.plant.arm import overrides
from hybrid.plant.native import split_effects
from hybrid.robot import Robot
from hybrid.robot.build import spec_text
from hybrid.robot.chain import Array
from hybrid.robot.spatial import central_inertia

_URDF = ("armature", "damping", "frictionloss")


@dataclass(frozen=True)
class Expressed:
    """A model as far as a kind of robot file can say it.

    Attributes:
        robot: Identified links, gravity, rotors, friction and springs.
        rest: What of the effects is not in it.
        learned: The learned remainder in words, if there is one.
    """

    robot: Robot
    rest: tuple[Effect, ...]
    learned: tuple[str, ...]


def robot_from_model(model: DynamicModel, fields: Sequence[str] = FIELDS) -> Expressed:
    """The robot with what was identified in the places that robot files have for it.

    Args:
        model: An identified model.
        fields: Fields that the file has for a joint, of ``FIELDS``.

    Raises:
        HybridError: No physically consistent links were identified.
    """
    if model.inertial is None:
        raise HybridError(
            "a simulator needs links that could be built; identify with "
            "consistent=True, on the command line --consistent"
        )
    robot, n = model.robot, model.robot.size
    inertial, gravity = model.inertial.copy(), robot.chain.gravity.copy()
    effects = []
    for effect in model.effects:
        change = effect.rigid_change(n, robot.chain.gravity)
        if change is None:
            effects.append(effect)
        else:
            inertial, gravity = inertial + change[0], gravity + change[1]
    values, rest = split_effects(effects, fields, n)
    quadratic, cubic, stiffness, preload = (
        values.get(name, np.zeros(n))
        for name in ("quadratic", "cubic", "stiffness", "preload")
    )
    chain = replace(
        robot.chain,
        inertial=inertial,
        gravity=gravity,
        armature=values.pop("armature"),
    )
    found = replace(
        robot,
        chain=chain,
        damping=values.pop("damping"),
        frictionloss=values.pop("frictionloss"),
        springref=-preload / np.where(stiffness > 0, stiffness, 1.0),
        stiffness=stiffness,
        quadratic=quadratic,
        cubic=cubic,
    )
    return Expressed(found, tuple(rest), _learned(model))


def _learned(model: DynamicModel) -> tuple[str, ...]:
    """The learned remainder in words, if there is one."""
    robot = model.robot
    if model.remainder is not None and model.remainder.parts:
        joints = [robot.joints[p.joint] for p in model.remainder.parts]
        return (f"learned remainder of {', '.join(joints)}",)
    return ()


def _in_words(robot: Robot, effect: Effect) -> str:
    joints = ", ".join(robot.joints[j] for j in effect.joints)
    gains = [f"{g.name} {effect.values[g.name]:.4g} {g.unit}" for g in effect.gains
             if effect.values[g.name]]  # fmt: skip
    return f"{effect.id} of {joints} ({', '.join(gains)})"


def mjcf_text(model: DynamicModel) -> tuple[str, tuple[str, ...]]:
    """An MJCF file without geometry, and what is not in it."""
    expressed = robot_from_model(model)
    robot, spec = expressed.robot, expressed.robot.mujoco_spec()
    rest = []
    for effect in expressed.rest:
        if overrides(effect, "edit_spec"):
            effect.edit_spec(spec, robot.joints)
        else:
            rest.append(_in_words(robot, effect))
    for k, name in enumerate(robot.joints):
        joint = spec.joint(name)
        if np.isfinite(robot.q_min[k]) and np.isfinite(robot.q_max[k]):
            joint.limited = 1
            joint.range = np.array([robot.q_min[k], robot.q_max[k]])
        if np.isfinite(robot.tau_max[k]):
            joint.actfrclimited = 1
            joint.actfrcrange = np.array([-1.0, 1.0]) * robot.tau_max[k]
        motor = spec.add_actuator(name=name, target=name)
        motor.trntype = 0  # at the joint
        motor.gainprm[0] = motor.gear[0] = 1.0
    for name, values in (
        ("velocity_limit", robot.v_max),
        ("acceleration_limit", robot.a_max),
    ):
        if np.isfinite(values).all():
            numeric = spec.add_numeric(name=name, size=robot.size)
            numeric.data = values
    spec.compile()
    return spec_text(spec), (*rest, *expressed.learned)


def urdf_text(model: DynamicModel) -> tuple[str, tuple[str, ...]]:
    """A URDF file without geometry, and what is not in it."""
    expressed = robot_from_model(model, _URDF)
    robot, chain = expressed.robot, expressed.robot.chain
    left = [_in_words(robot, effect) for effect in expressed.rest]
    left += expressed.learned
    if not np.allclose(chain.gravity, [0.0, 0.0, -9.81], atol=1e-6):
        left.append(f"gravity {_text(chain.gravity)} m/s²")
    root = ElementTree.Element("robot", name=robot.name)
    ElementTree.SubElement(root, "link", name="link_0")
    for k in range(robot.size):
        _add_link(root, f"link_{k + 1}", chain.inertial[k])
        _add_joint(root, robot, k)
    for k, joint in enumerate(robot.joints):
        if chain.armature[k] > 0:
            drive = ElementTree.SubElement(root, "transmission", name=f"{joint}_drive")
            ElementTree.SubElement(drive, "type").text = "SimpleTransmission"
            ElementTree.SubElement(drive, "joint", name=joint)
            motor = ElementTree.SubElement(drive, "actuator", name=f"{joint}_motor")
            inertia = repr(float(chain.armature[k]))
            ElementTree.SubElement(motor, "drake:rotor_inertia", value=inertia)
    root.set("xmlns:drake", "http://drake.mit.edu")
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n", tuple(left)


def _add_link(root: ElementTree.Element, name: str, inertial: Array) -> None:
    mass, center, about = central_inertia(inertial)
    link = ElementTree.SubElement(root, "link", name=name)
    item = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(item, "origin", xyz=_text(center), rpy="0 0 0")
    ElementTree.SubElement(item, "mass", value=repr(float(mass)))
    six = {
        f"i{'xyz'[r]}{'xyz'[c]}": repr(float(about[r, c]))
        for r in range(3)
        for c in range(r, 3)
    }
    ElementTree.SubElement(item, "inertia", six)


def _add_joint(root: ElementTree.Element, robot: Robot, k: int) -> None:
    chain, name = robot.chain, robot.joints[k]
    limited = np.isfinite(robot.q_min[k]) and np.isfinite(robot.q_max[k])
    kind = "prismatic" if not chain.revolute[k] else "revolute"
    if kind == "revolute" and not limited:
        kind = "continuous"
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    angles = Rotation.from_matrix(chain.rotation[k]).as_euler("xyz")
    ElementTree.SubElement(
        joint, "origin", xyz=_text(chain.translation[k]), rpy=_text(angles)
    )
    ElementTree.SubElement(joint, "parent", link=f"link_{k}")
    ElementTree.SubElement(joint, "child", link=f"link_{k + 1}")
    ElementTree.SubElement(joint, "axis", xyz=_text(chain.axis[k]))
    given = {"effort": robot.tau_max[k], "velocity": robot.v_max[k]}
    limits = {key: repr(float(x)) for key, x in given.items() if np.isfinite(x)}
    limits = {"effort": "0", "velocity": "0"} | limits  # 0 is read as none
    if limited:
        limits["lower"] = repr(float(robot.q_min[k]))
        limits["upper"] = repr(float(robot.q_max[k]))
    if np.isfinite(robot.a_max[k]):
        limits["drake:acceleration"] = repr(float(robot.a_max[k]))
    ElementTree.SubElement(joint, "limit", limits)
    ElementTree.SubElement(
        joint, "dynamics",
        damping=repr(float(robot.damping[k])),
        friction=repr(float(robot.frictionloss[k])),
    )  # fmt: skip


def _text(values: Sequence[float] | Array) -> str:
    return " ".join(repr(float(x)) for x in values)
