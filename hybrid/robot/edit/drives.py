"""Edit the actuators of an MJCF file."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from hybrid.robot.actuators import motors_of
from hybrid.robot.edit.change import Actuator
from hybrid.robot.edit.document import Document, Tag
from hybrid.robot.mjcf import joint_numbers

KINDS = (
    "general", "motor", "position", "velocity", "intvelocity", "damper", "dcmotor",
    "pid",
)  # fmt: skip
# Attributes of the short forms, which the general form has by other names.
_SHORT = ("kp", "kv", "dampratio", "timeconst", "inheritrange")


def edit_drives(
    document: Document,
    model: Any,
    joints: Sequence[str],
    drives: Mapping[int, Actuator],
) -> tuple[str, ...]:
    """Change actuators of an MJCF file.

    Returns:
        Changes that the file cannot express, in words.
    """
    numbers, notes = joint_numbers(model, joints), list[str]()
    for j, new in drives.items():
        own = [(a, gear) for a, at, gear in motors_of(model) if at == numbers[j]]
        found = actuator_tags(document, joints[j])
        if len(own) != len(found) or not own:
            notes.append(f"drive of {joints[j]}, which has no actuator in the file")
            continue
        for (a, gear), tag in zip(own, found, strict=True):
            for missing in _edit(document, model, a, gear, tag, new):
                notes.append(f"{missing} of {joints[j]}, whose actuator has no place")
    return tuple(dict.fromkeys(notes))


def actuator_tags(document: Document, joint: str) -> list[Tag]:
    """Elements of the actuators of a joint."""
    return [
        tag
        for tag in document.tags
        if tag.path[-2:-1] == ("actuator",)
        and tag.path[-1] in KINDS
        and tag.attributes.get("input") != "none"
        and joint in (tag.attributes.get("joint"), tag.attributes.get("jointinparent"))
    ]


def _edit(
    document: Document, model: Any, a: int, gear: float, tag: Tag, new: Actuator
) -> Iterator[str]:
    """Change one actuator; yield the changes that it cannot express."""
    if new.latency:
        steps = math.ceil(new.latency / model.opt.timestep) + 1
        delay = {"delay": new.latency, "nsample": steps, "interp": "linear"}
        document.set(tag, delay)
    if math.isfinite(new.limit):
        most = new.limit / abs(gear)
        if model.actuator_forcelimited[a]:
            most = min(most, float(np.abs(model.actuator_forcerange[a]).max()))
        document.set(tag, {"forcelimited": "true", "forcerange": (-most, most)})
    gain, bias = model.actuator_gainprm[a].copy(), model.actuator_biasprm[a].copy()
    kind, plain = model.actuator_biastype[a], mujoco.mjtBias.mjBIAS_NONE
    linear = kind == plain or kind == mujoco.mjtBias.mjBIAS_AFFINE
    if not linear or model.actuator_gaintype[a] != mujoco.mjtGain.mjGAIN_FIXED:
        yield "a change of the torque"
        return
    if kind == plain:
        bias[:] = 0.0
    if (new.stiffness, new.damping) != (1.0, 1.0) and not bias[1:3].any():
        yield "gains of a servo"
    gain[0] *= new.gain * (new.stiffness if bias[1] else new.damping if bias[2] else 1)
    bias[:3] *= new.gain * np.array([1.0, new.stiffness, new.damping])
    given: dict[str, Any] = {}
    if new.lag and model.actuator_dyntype[a] == mujoco.mjtDyn.mjDYN_NONE:
        given = {"dyntype": "filter", "dynprm": new.lag}
    elif new.lag:
        yield "a lag"
    same = (gain == model.actuator_gainprm[a]).all()
    if same and (bias == model.actuator_biasprm[a]).all() and not given:
        return
    given |= {"gaintype": "fixed", "gainprm": gain[0]}
    if bias[:3].any():
        given |= {"biastype": "affine", "biasprm": bias[:3]}
    if "inheritrange" in tag.attributes:
        given["ctrlrange"] = model.actuator_ctrlrange[a]
    document.set(tag, given, drop=_SHORT, name="general")
