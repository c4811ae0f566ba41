"""Models of one simulated arm, and a control loop that feeds their torque forward.

Shared by the experiments on compensation; it prints nothing. The arm is the documented
COMAN-like truth with three effects more: a hose that pulls like a spring, a
coupled wrist, and a base that is not level.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from coman import ROOT, TRUTH

from hybrid import DynamicModel, Effect, Recording, Robot, identify, simulate
from hybrid.diagnose.diagnose import examine
from hybrid.effects import effect_class, effect_from_dict
from hybrid.errors import HybridWarning
from hybrid.files import write_json
from hybrid.identify.problem import build_problem
from hybrid.plant import Plant, load_truth
from hybrid.report import write_results
from hybrid.robot.chain import Array
from hybrid.signals import Motion

REPORT = ROOT / "reports" / "compensation_in_the_loop"
KEPT = REPORT / "diagnosed.json"
# Effects that the three stages fit by themselves, or have a law in place of.
IN_STAGES = (
    "armature", "torque_offset", "coulomb", "viscous", "threshold_friction",
    "load_friction", "torque_ripple", "stribeck", "nonlinear_viscous",
    "asymmetric_friction", "improved_stribeck", "presliding", "link_inertia",
)  # fmt: skip
CONTROL, FREQUENCY, SETTLE = 1000.0, 3.0, 0.5  # Hz, Hz of the feedback, s
ADDED = (
    ("spring", ["shoulder"], {"stiffness": 8.0, "preload": -6.0}),
    ("transmission_coupling", ["wrist_2", "wrist_3"], {"viscous": 0.3, "coulomb": 0.4}),
    ("gravity_tilt", None, {"roll": 0.03, "pitch": -0.02}),
)


def load_arm() -> tuple[Robot, Plant]:
    """The arm as its file says, and as it is."""
    robot, plant = load_truth(TRUTH)
    added = [
        effect_from_dict(
            {"effect": name, "joints": joints or list(robot.joints), "values": values},
            robot.joints,
        )
        for name, joints, values in ADDED
    ]
    return robot, replace(plant, effects=(*plant.effects, *added), servo=None)


def nominal_model(robot: Robot) -> DynamicModel:
    """What the robot file says, as a model."""
    declared = {
        "armature": ("inertia", robot.chain.armature),
        "coulomb": ("level", robot.frictionloss),
        "viscous": ("coefficient", robot.damping),
    }
    effects: list[Effect] = [
        effect_class(name)((j,), {gain: float(x)})
        for name, (gain, values) in declared.items()
        for j, x in enumerate(values)
    ]
    base = build_problem(robot.chain, ()).base
    return DynamicModel(robot, base, tuple(effects), inertial=robot.chain.inertial)


def diagnosed_effects(robot: Robot, plant: Plant) -> list[Effect]:
    """What a diagnosis names on logs of its own, and the stages do not fit anyway.

    An arm is diagnosed once; later fits find the gains anew. It takes minutes, so that
    the answer is kept beside the results; delete that file to diagnose again.
    """
    if KEPT.exists():
        content = json.loads(KEPT.read_text("utf-8"))
        return [effect_from_dict(item, robot.joints) for item in content]
    logs = simulate(plant, trajectories=3, duration=8.0, seed=1000)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        named = examine(robot, logs).effects
    new = [e for e in named if e.id not in IN_STAGES and not e.not_in_loop]
    write_results(KEPT.with_name("named.json"), {"named": [e.id for e in named]})
    write_json(KEPT, [effect.as_dict(robot.joints) for effect in new])
    return new


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


def torque(model: DynamicModel, q: Array, v: Array, a: Array) -> Array:
    """Torque of a model at states, shape (N, n), [N·m]."""
    t, ok = np.arange(len(q)) / CONTROL, np.ones(len(q), dtype=bool)
    return model.predict(Motion(t, q, v, a, np.full_like(q, np.nan), ok))
