"""Friction and ripple that an MJCF joint has no attribute for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.actuators import passive_motors
from hybrid.robot.edit.document import Document, element
from hybrid.robot.mjcf import joint_names
from hybrid.robot.robot import Robot


def put_dry(document: Document, joint: str, dry: Mapping[str, Any]) -> None:
    """Dry friction of a joint whose own rises to a level: that of a tendon on it."""
    parts = [
        (tag, own[0])
        for tag in document.find("tendon", "fixed")
        if len(own := document.within(tag, "joint")) == 1
        and own[0].attributes.get("joint") == joint
    ]
    for tag, its in parts:
        pull = abs(float(its.attributes.get("coef", 1.0)))
        document.set(tag, {**dry, "frictionloss": dry["frictionloss"] / pull})
        dry = {"frictionloss": 0.0}
    if not parts and dry["frictionloss"]:
        head = element("fixed", {"name": f"{joint}/dry", **dry}).replace("/>", ">")
        text = head + element("joint", {"joint": joint, "coef": 1.0}) + "</fixed>"
        document.put(document.tags[0].close, f"  <tendon>{text}</tendon>\n")


def put_motors(document: Document, model: Any, new: Robot, stiffness: Array) -> None:
    """Ripple and friction that falls: motors that nothing commands.

    Args:
        document: The file.
        model: MuJoCo's model of it, as it was.
        new: The arm as it shall be.
        stiffness: That of bristles at each joint, shape (n,), [N·m/rad].
    """
    for joint in new.joints:
        drop_motors(document, joint)
    for number, (j, sine, cosine, k) in enumerate(new.ripple, 1):
        size, phase = np.hypot(sine, cosine), np.arctan2(-cosine, -sine)
        cogging = {"cogging": (size, k, phase)}
        _put_motor(document, new.joints[int(j)], f"ripple_{number}", cogging)
    for number, (j, level, speed) in enumerate(new.falling, 1):
        # Bristles that have nothing to hold once they slide need no damping: the dry
        # friction beside them stops the joint.
        lugre = {"lugre": (stiffness[int(j)], 0.0, 0.0, level, speed)}
        _put_motor(document, new.joints[int(j)], f"falling_{number}", lugre)
    _room(document, model, new)


def drop_motors(document: Document, joint: str) -> None:
    """Take out the motors of a joint that nothing commands."""
    for kind in ("dcmotor", "general"):
        for tag in document.find("actuator", kind, input="none", joint=joint):
            document.replace(tag, "")


def _put_motor(document: Document, joint: str, name: str, has: dict[str, Any]) -> None:
    # A resistance that lets no current flow: no damping by it.
    motor = {"input": "none", "motorconst": 1.0, "resistance": 1e12}
    given = {"name": f"{joint}/{name}", "joint": joint, **motor, **has}
    text = f"  <actuator>{element('dcmotor', given)}</actuator>\n"
    document.put(document.tags[0].close, text)


def _room(document: Document, model: Any, new: Robot) -> None:
    """Give keyframes a bend of each bristle: none, of those that are new."""
    names = joint_names(model)
    gone = {
        int(model.actuator_actadr[a])
        for a, joint, _ in passive_motors(model)
        if names[joint] in new.joints
    }
    for tag in document.find("keyframe", "key"):
        if "act" in tag.attributes:
            words = enumerate(tag.attributes["act"].split())
            kept = [word for k, word in words if k not in gone]
            document.set(tag, {"act": " ".join(kept + ["0"] * len(new.falling))})
