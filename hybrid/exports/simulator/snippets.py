"""Write actuators for Isaac Lab, and files for domain randomisation.

Names of joints appear as literals only.
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hybrid.arrays import Array
from hybrid.exports.c_code import TEMPLATES
from hybrid.exports.simulator.model import (
    fields_of_model,
    model_simulator,
    usual_motion,
)
from hybrid.exports.simulator.plan import drive_changes
from hybrid.exports.simulator.ranges import Ranges, joint_numbers, ranges
from hybrid.exports.simulator.simulator import effect_note
from hybrid.model.dynamic_model import DynamicModel
from hybrid.robot import Robot
from hybrid.robot.edit.change import Actuator
from hybrid.signals import Motion
from hybrid.templates import render_template

_DRAWS = 400  # from the posterior
# Changes of an actuator that Isaac Lab has a place for.
_ACTUATORS = {"latency", "limit", "stiffness", "damping"}
_STEP = 0.005  # s, if the step of the simulation is not known
# Field of MuJoCo's model by the name of a range, its column, and whether it may be < 0.
_DOF: dict[str, tuple[str, int | None, bool]] = {
    "armature": ("dof_armature", None, False),
    "damping": ("dof_damping", None, False),
    "frictionloss": ("dof_frictionloss", None, False),
    "quadratic": ("dof_dampingpoly", 0, True),
    "cubic": ("dof_dampingpoly", 1, False),
}


def isaac_lab(
    model: DynamicModel, motions: Sequence[Motion] = ()
) -> tuple[str, tuple[str, ...]]:
    """Actuator configuration for Isaac Lab, and notes on what it lacks."""
    bare = replace(model, robot=replace(model.robot, path=""))  # numbers, no shapes
    edited = model_simulator(bare, kind="urdf", motions=motions)
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


def isaac_events(name: str, ranges: Ranges) -> str:
    """Event terms for Isaac Lab."""
    table: dict[str, dict[str, tuple[float, float]]] = {}
    for word, own in (("friction", "frictionloss"), ("armature", "armature")):
        for joint, low, high in zip(ranges.joints, *ranges.of(own), strict=True):
            if np.isfinite(low):
                both = (max(float(low), 0.0), float(high))
                key = f"{word}_distribution_params"
                table.setdefault(re.escape(joint), {})[key] = both
    return _rendered("isaaclab_events", name, table=table)


def mjx(name: str, ranges: Ranges, nominal: Mapping[str, Array]) -> str:
    """Function that randomises a model of MJX."""
    own = [name for name in _DOF if np.isfinite(ranges.of(name)).any()]
    n = len(ranges.joints)
    mean = np.concatenate([nominal[name] for name in own]) if own else np.zeros(0)
    draws = np.tile(mean, (len(ranges.draws), 1))
    for k, (joint, name_of) in enumerate(ranges.keys):
        if name_of in own:
            at = own.index(name_of) * n + ranges.joints.index(joint)
            draws[:, at] = ranges.draws[:, k]
    values, vectors = np.linalg.eigh(np.atleast_2d(np.cov(draws, rowvar=False)))
    factor = vectors * np.sqrt(np.clip(values, 0.0, None))
    return _rendered(
        "mjx",
        name,
        joints=list(ranges.joints),
        fields=[_DOF[x] for x in own],
        mean=mean.tolist(),
        factor=factor[:, values > 1e-12 * values.max(initial=1e-300)].tolist(),
    )


def mjx_notes(robot: Robot) -> Iterator[str]:
    """What MJX on JAX, unlike MuJoCo and MJX on Warp, does not take from a file."""
    motors = {int(row[0]) for row in (*robot.ripple, *robot.falling)}
    curved = np.flatnonzero((robot.quadratic != 0) | (robot.cubic != 0))
    for joints, what in (
        (curved, "quadratic and cubic damping of {}, which it ignores"),
        (sorted(motors), "ripple or falling friction of {}, which it refuses"),
    ):
        if len(joints):
            names = ", ".join(robot.joints[j] for j in joints)
            yield "for MJX on JAX: " + what.format(names)


def write_ranges(model: DynamicModel, folder: Path, stem: str) -> tuple[str, ...]:
    """Write intervals and correlations as YAML, and Python for Isaac Lab and MJX.

    Draws have a fixed seed, so that the files of a model are always the same.

    Returns:
        What MJX on JAX does not take.
    """
    found = ranges(model, draws=_DRAWS)
    nominal = fields_of_model(model, (usual_motion(model),))
    # Isaac Lab has one dry and one viscous friction, as URDF has.
    plain = ranges(model, kind="urdf", draws=_DRAWS)
    name = model.robot.name
    texts = {
        f"{stem}_ranges.yaml": yaml.safe_dump(
            {"robot": name, **found.as_dict()}, sort_keys=False, allow_unicode=True
        ),
        f"{stem}_isaaclab_events.py": isaac_events(name, plain),
        f"{stem}_mjx.py": mjx(name, found, joint_numbers(nominal)),
    }
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return tuple(mjx_notes(nominal))


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
