"""Models of the arm of ``compensation.py``: nominal, fitted, with diagnosed effects.

It prints nothing.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from compensation import nominal_model

from hybrid import DynamicModel, Effect, Recording, Robot, identify, simulate
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import effect_from_dict
from hybrid.errors import HybridWarning
from hybrid.files import write_json
from hybrid.plant import Plant
from hybrid.report import write_results

# Effects that the three stages fit by themselves, or have a law in place of. A gain of
# the torque that all numbers of a link share is in those numbers.
IN_STAGES = (
    "armature", "torque_offset", "coulomb", "viscous", "threshold_friction",
    "load_friction", "torque_ripple", "stribeck", "nonlinear_viscous",
    "asymmetric_friction", "presliding", "link_inertia",
    "torque_gain",
)  # fmt: skip


def diagnosed_effects(robot: Robot, plant: Plant, kept: Path) -> list[Effect]:
    """What a diagnosis names on logs of its own, and the stages do not fit anyway.

    An arm is diagnosed once; later fits find the gains anew. It takes minutes, so that
    the answer is kept in a file; delete it to diagnose again.

    Args:
        robot: The arm as its file has it.
        plant: The true arm.
        kept: File of the answer.
    """
    if kept.exists():
        content = json.loads(kept.read_text("utf-8"))
        effects = [effect_from_dict(item, robot.joints) for item in content]
        return [effect for effect in effects if not _at_bound(effect)]
    logs = simulate(plant, trajectories=3, duration=8.0, seed=1000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        named = examine(robot, logs).effects
    new = [e for e in named if e.id not in IN_STAGES and not e.not_in_loop]
    write_results(kept.with_name("named.json"), {"named": [e.id for e in named]})
    write_json(kept, [effect.as_dict(robot.joints) for effect in new])
    return [effect for effect in new if not _at_bound(effect)]


def _at_bound(effect: Effect) -> bool:
    """Whether a shape ended at a bound, where gains cannot be told apart."""
    return any(
        np.isclose(effect.values[s.name], bound, rtol=1e-3)
        for s in effect.shapes
        for bound in (s.lower, s.upper)
    )


def fitted_models(
    robot: Robot, logs: Sequence[Recording], named: Sequence[Effect]
) -> dict[str, DynamicModel]:
    """Nominal, plain least squares, three stages, and these with diagnosed effects."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        three = identify(robot, logs).model
        diagnosed = identify(robot, logs, effects=named).model
    return {
        "nominal": nominal_model(robot),
        "plain LS": three.simpler["LS"],
        "three stages": three,
        "+ diagnosed": diagnosed,
    }
