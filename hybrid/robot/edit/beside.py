"""Dry friction and ripple that an MJCF joint has no attribute for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.robot.edit.document import Document, element
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


def put_ripples(document: Document, old: Robot, new: Robot) -> None:
    """Torque that repeats with position: cogging of motors that nothing commands."""
    if np.array_equal(old.ripple, new.ripple):
        return
    for tag in document.find("actuator", "dcmotor", input="none"):
        if tag.attributes.get("joint") in new.joints:
            document.replace(tag, "")
    # A resistance that lets no current flow: no damping by it.
    motor = {"input": "none", "motorconst": 1.0, "resistance": 1e12}
    for number, (j, sine, cosine, k) in enumerate(new.ripple, 1):
        joint, size = new.joints[int(j)], np.hypot(sine, cosine)
        given = {"name": f"{joint}/ripple_{number}", "joint": joint, **motor}
        given["cogging"] = size, k, np.arctan2(-cosine, -sine)
        text = f"  <actuator>{element('dcmotor', given)}</actuator>\n"
        document.put(document.tags[0].close, text)
