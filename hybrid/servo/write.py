"""The user's own simulator file with servos as they were found, all else as it was."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.errors import RobotError
from hybrid.files import atomic_path
from hybrid.robot import Robot
from hybrid.robot.build import spec_text
from hybrid.robot.rewrite import Tag, tags
from hybrid.servo.drive import Drive
from hybrid.servo.simulator import (
    CONSTANT,
    bristle_damping,
    file_step,
    servo_spec,
    springs,
)

_ACTUATORS = (
    "general", "motor", "position", "velocity", "intvelocity", "damper", "dcmotor",
    "pid",
)  # fmt: skip
_KEPT = ("name", "ctrlrange", "ctrllimited", "group")


def write_servos(robot: Robot, drive: Drive, path: str | Path) -> None:
    """Write the robot's MJCF file again with other servos; of a URDF, an MJCF skeleton.

    The attributes of the joints and their actuators change, every other byte stays. The
    delay is a number of steps of the file's own clock, rounded up to hold it.

    Args:
        robot: An arm read from a file.
        drive: The servos.
        path: Where the new file shall be.

    Raises:
        RobotError: The file is gone, or a joint or actuator stands in another file.
    """
    if Path(robot.path).suffix.lower() == ".urdf":
        text = _skeleton(robot, drive).encode()
    else:
        text = _edited(robot, drive)
    with atomic_path(path) as temporary:
        temporary.write_bytes(text)


def _edited(robot: Robot, drive: Drive) -> bytes:
    source = Path(robot.path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise RobotError(f"{source}: cannot be read ({error.strerror})") from error
    found = list(tags(content, source))
    for start, end, text in sorted(_edits(content, found, robot, drive), reverse=True):
        content = content[:start] + text.encode() + content[end:]
    return content


def _edits(
    content: bytes, found: list[Tag], robot: Robot, drive: Drive
) -> Iterator[tuple[int, int, str]]:
    """Start tags of joints and actuators, and what stands there instead."""
    radians = any(
        x.path[-1] == "compiler" and x.attributes.get("angle") == "radian"
        for x in found
    )
    step = file_step(robot)
    stiffness, relaxed = springs(robot, drive)
    sections = [x for x in found if x.path == ("mujoco", "actuator")]
    for j, name in enumerate(robot.joints):
        joint = _joint(found, name, robot)
        turn = 1.0 if radians or not robot.chain.revolute[j] else 180.0 / math.pi
        # A spring counts from its angle, and the angle at which the file draws the arm
        # is where the log has zero.
        reference = float(joint.attributes.get("ref", "0"))
        given = {
            "damping": drive["damping"][j],
            "frictionloss": 0.0,
            "armature": drive["armature"][j],
            "stiffness": stiffness[j],
            "springref": relaxed[j] * turn,
            "ref": reference - drive["zero"][j] * turn,
        }
        yield _changed(content, joint, joint.path[-1], given)
        own = [
            x for x in found if x.path[-2:-1] == ("actuator",)
            and x.path[-1] in _ACTUATORS and x.attributes.get("joint") == name
        ]  # fmt: skip
        motor = actuator_attributes(drive, j, step)
        if own:
            kept = {k: x for k, x in own[0].attributes.items() if k in _KEPT}
            text = _element("general", {"joint": name, **kept, **motor})
            closing = "/>" if content[: own[0].end].endswith(b"/>") else ">"
            if closing == ">":
                raise RobotError(f"{robot.path}: actuator of {name!r} has content")
            yield own[0].start, own[0].end, text
        elif sections:
            text = _element("general", {"name": name, "joint": name, **motor})
            yield sections[0].end, sections[0].end, f"\n    {text}"
        else:
            raise RobotError(f"{robot.path}: no <actuator> section to put a servo into")


def _joint(found: list[Tag], name: str, robot: Robot) -> Tag:
    """The start tag of a joint."""
    for tag in found:
        if tag.path[-1] == "joint" and "body" in tag.path:
            if tag.attributes.get("name") == name:
                return tag
    raise RobotError(
        f"{robot.path}: joint {name!r} is not in this very file; valid are files "
        "without include, with named joints"
    )


def actuator_attributes(drive: Drive, j: int, step: float) -> dict[str, Any]:
    """MJCF attributes of one servo: a DC motor behind a position controller.

    Args:
        drive: The servos.
        j: Joint.
        step: Step of the simulation, [s].
    """
    gain = [1.0, CONSTANT, 0, 0, drive["stiffness"][j], 0, 0]
    coulomb, delay = drive["coulomb"][j], float(drive["delay"][j])
    bias = [
        0,
        0,
        0,
        coulomb,
        coulomb + drive["stiction"][j],
        drive["stribeck_speed"][j],
    ]
    given = {
        "gear": 1.0,
        "forcelimited": "false",
        "actearly": "true",
        "dyntype": "dcmotor",
        "gaintype": "dcmotor",
        "biastype": "dcmotor",
        "input": "pos",
        "gainprm": [*gain, drive["stall"][j] / CONSTANT],
        "biasprm": bias,
        "dynprm": [0, 0, 0, 0, 0, drive["bristle"][j], bristle_damping(drive)[j]],
    }
    if delay > 0:
        given |= {"delay": delay, "nsample": math.ceil(delay / step) + 1}
        given["interp"] = "linear"
    return given


def _skeleton(robot: Robot, drive: Drive) -> str:
    """Links, joints and servos of an arm as MJCF; no shapes."""
    step = file_step(robot)
    spec = servo_spec(robot, drive["zero"])
    spec.option.timestep = step
    stiffness, relaxed = springs(robot, drive)
    for j, actuator in enumerate(spec.actuators):
        joint = spec.joint(robot.joints[j])
        joint.armature, joint.frictionloss = drive["armature"][j], 0.0
        joint.damping = np.array([drive["damping"][j], 0.0, 0.0])
        joint.stiffness = np.array([stiffness[j], 0.0, 0.0])
        joint.springref = relaxed[j]
        given = actuator_attributes(drive, j, step)
        for name in ("gainprm", "biasprm", "dynprm"):
            getattr(actuator, name)[: len(given[name])] = given[name]
        actuator.delay = given.get("delay", 0.0)
        actuator.nsample = given.get("nsample", 0)
        actuator.interp = int("interp" in given)
    spec.compile()
    return spec_text(spec)


def _changed(
    content: bytes, tag: Tag, name: str, given: Mapping[str, Any]
) -> tuple[int, int, str]:
    """A start tag with some attributes set, the others as they were."""
    text = content[tag.start : tag.end].decode()
    for key in given:
        text = re.sub(rf"""\s+{key}\s*=\s*("[^"]*"|'[^']*')""", "", text)
    added = " ".join(f'{key}="{_number(x)}"' for key, x in given.items())
    return tag.start, tag.end, text.replace(f"<{name}", f"<{name} {added}", 1)


def _element(name: str, given: Mapping[str, Any]) -> str:
    words = " ".join(f'{key}="{_number(x)}"' for key, x in given.items())
    return f"<{name} {words}/>"


def _number(value: Any) -> str:
    if isinstance(value, str):
        return html.escape(value)
    if isinstance(value, int):
        return str(value)
    return " ".join(repr(float(x)) for x in np.atleast_1d(value))
