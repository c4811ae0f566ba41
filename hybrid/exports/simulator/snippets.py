"""Write actuators for Isaac Lab, and files for domain randomisation.

Names of joints appear as literals only.
"""

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hybrid.arrays import Array
from hybrid.exports.c_code import TEMPLATES
from hybrid.exports.simulator.model import model_simulator
from hybrid.exports.simulator.plan import drive_changes
from hybrid.exports.simulator.ranges import Ranges, joint_numbers, ranges
from hybrid.exports.simulator.simulator import effect_note
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator
from hybrid.signals import Motion
from hybrid.templates import render_template

_DRAWS = 200  # from the posterior
_DIGITS = 5  # of a number that is drawn
# Changes of an actuator that Isaac Lab has a place for.
_ACTUATORS = {"latency", "limit", "stiffness", "damping"}
_STEP = 0.005  # s, if the step of the simulation is not known
# Field of MuJoCo's model by the name of a range, and its column.
_DOF: dict[str, tuple[str, int | None]] = {
    "armature": ("dof_armature", None),
    "damping": ("dof_damping", None),
    "frictionloss": ("dof_frictionloss", None),
    "knee": ("dof_frictionloss", None),
    "quadratic": ("dof_dampingpoly", 0),
    "cubic": ("dof_dampingpoly", 1),
}
_TENDON = ("tendon_frictionloss", None)


def isaac_lab(
    model: DynamicModel, motions: Sequence[Motion] = ()
) -> tuple[str, tuple[str, ...]]:
    """Actuator configuration for Isaac Lab, and notes on what it lacks."""
    bare = replace(model, robot=replace(model.robot, path=""))  # numbers, no shapes
    edited = model_simulator(bare, kind="isaaclab", motions=motions)
    robot, drives = edited.robot, drive_changes(edited.rest)
    new = [drives.get(j, Actuator()) for j in range(robot.size)]
    known = model.robot.timestep
    step = known if math.isfinite(known) else _STEP
    delay = max(x.latency for x in new) / step
    limit = np.minimum(robot.tau_max, [x.limit for x in new])
    kp = model.robot.kp * [x.stiffness for x in new]
    kd = model.robot.kd * [x.damping for x in new]
    table = {
        "stiffness": kp, "damping": kd, "effort_limit": limit,
        "velocity_limit": robot.v_max, "armature": robot.chain.armature,
        "friction": robot.frictionloss, "dynamic_friction": robot.frictionloss,
        "viscous_friction": robot.damping,
    }  # fmt: skip
    fields: dict[str, Any] = {
        name: _by_joint(robot.joints, x) for name, x in table.items()
    } | {"min_delay": math.floor(delay), "max_delay": math.ceil(delay)}
    expressed = {
        effect_note(robot, e) for e in edited.rest
        if e.actuator and e.actuator.keys() <= _ACTUATORS
    }  # fmt: skip
    notes = tuple(note for note in edited.notes if note not in expressed)
    text = _rendered(
        "isaaclab",
        robot.name,
        step=step,
        names=[re.escape(name) for name in robot.joints],
        fields=fields,
    )
    return text, notes


def isaac_events(ranges: Ranges) -> str:
    """Event term for Isaac Lab, which draws friction and rotors at each reset."""
    joints, drawn = ranges.robot.joints, ("frictionloss", "damping", "armature")
    draws = _draws(ranges, [(joint, own) for own in drawn for joint in joints])
    names = [re.escape(joint) for joint in joints]
    return _rendered("isaaclab_events", ranges.robot.name, joints=names, draws=draws)


def mjx(ranges: Ranges) -> str:
    """Function that randomises a model of MJX, made from the file of an arm."""
    places = dict[tuple[str, int | None], list[tuple[str, str]]]()
    for joint, own in ranges.keys:
        if (place := _place(ranges.robot, joint, own)) is not None:
            places.setdefault(place, []).append((joint, own))
    fields = [
        (*place, [f"{x}/dry" if place == _TENDON else x for x, _ in keys])
        for place, keys in places.items()
    ]
    draws = _draws(ranges, [key for own in places.values() for key in own])
    return _rendered("mjx", ranges.robot.name, fields=fields, draws=draws)


def _place(robot: Robot, joint: str, own: str) -> tuple[str, int | None] | None:
    """Field of MuJoCo's model that holds a number of a joint, if one does.

    Friction that rises takes the joint's dry friction, whose own is that of a tendon.
    """
    j = robot.joints.index(joint)
    if own == "frictionloss" and robot.knee[j]:
        return _TENDON if robot.frictionloss[j] else None
    return _DOF.get(own)


def _draws(ranges: Ranges, keys: Sequence[tuple[str, str]]) -> list[list[float]]:
    """Draws of numbers by joint and name; those without an interval do not vary."""
    numbers, count = joint_numbers(ranges.robot), len(ranges.draws)
    columns = [
        ranges.draws[:, ranges.keys.index(key)] if key in ranges.keys
        else np.full(count, numbers[key[1]][ranges.robot.joints.index(key[0])])
        for key in keys
    ]  # fmt: skip
    table = np.reshape(columns, (len(keys), count)).T
    return [[float(f"{x:.{_DIGITS}g}") for x in row] for row in table.tolist()]


def mjx_notes(robot: Robot, *, drawn: bool = False) -> list[str]:
    """What MJX on JAX, unlike MuJoCo and MJX on Warp, does not take from a file.

    If numbers are ``drawn``, also those that the function for MJX does not draw.
    """
    falls = {int(row[0]) for row in robot.falling}
    motors = falls | {int(row[0]) for row in robot.ripple}
    curved = np.flatnonzero((robot.quadratic != 0) | (robot.cubic != 0)).tolist()
    hoses = {int(row[0]) for row in robot.stiffening}
    found: list[tuple[Collection[int], str]] = [
        (hoses, "for MJX on JAX: stiffening of the spring of {}, which it ignores"),
        (curved, "for MJX on JAX: quadratic and cubic damping of {}, which it ignores"),
        (motors, "for MJX on JAX: ripple or falling friction of {}, which it refuses"),
    ]
    if drawn:
        tied = np.flatnonzero((robot.knee != 0) & (robot.frictionloss == 0)).tolist()
        rising = "dry friction beside that which rises with speed"
        found[:0] = [
            (falls, "for MJX: draws of friction that falls with speed, of {}"),
            (tied, f"for MJX: draws of {rising}, of {{}}"),
        ]
    return [
        text.format(", ".join(robot.joints[j] for j in sorted(joints)))
        for joints, text in found
        if joints
    ]


def write_ranges(model: DynamicModel, folder: Path, stem: str) -> tuple[str, ...]:
    """Write intervals and correlations as YAML, and Python for Isaac Lab and MJX.

    Draws have a fixed seed, so that the files of a model are always the same.

    Returns:
        What the function for MJX does not draw, or MJX on JAX does not take.
    """
    found = ranges(model, draws=_DRAWS)
    # Python draws no links: rotors would have to change with these.
    of_mujoco, of_isaac = (
        ranges(model, kind=kind, draws=_DRAWS, links=False)
        for kind in ("mjcf", "isaaclab")
    )
    content = {"robot": model.robot.name, **found.as_dict()}
    texts = {
        f"{stem}_ranges.yaml": yaml.safe_dump(
            content, sort_keys=False, allow_unicode=True
        ),
        f"{stem}_isaaclab_events.py": isaac_events(of_isaac),
        f"{stem}_mjx.py": mjx(of_mujoco),
    }
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return tuple(mjx_notes(of_mujoco.robot, drawn=True))


def _by_joint(joints: Sequence[str], values: Array) -> dict[str, float] | None:
    """Values by joint as a pattern; unknown values are left to the robot's file."""
    found = {
        re.escape(name): float(x)
        for name, x in zip(joints, values, strict=True)
        if np.isfinite(x)
    }
    return found or None


def _rendered(template: str, name: str, **content: Any) -> str:
    """Python for an arm of a name, which stands in a docstring."""
    plain = re.sub(r"[^\w .+-]", "_", name)
    return render_template(TEMPLATES / f"{template}.py.j2", name=plain, **content)
