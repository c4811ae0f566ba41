"""A simulated arm with more effects than its file and three stages know.

Shared by the experiments on compensation; it prints nothing. The arm is the documented
COMAN-like truth with three effects more: a hose that pulls like a spring, a
coupled wrist, and a base that is not level.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from coman import TRUTH

from hybrid import DynamicModel, Effect, Recording, Robot, simulate
from hybrid.arrays import Array
from hybrid.effects import effect_class, effect_from_dict
from hybrid.effects.payload import Payload
from hybrid.plant import Plant, load_truth
from hybrid.regression.problem import build_problem
from hybrid.signals import Motion

CONTROL, FREQUENCY, SETTLE = 1000.0, 3.0, 0.5  # Hz, Hz of the feedback, s
ADDED = (
    ("spring", ["shoulder"], {"stiffness": 8.0, "preload": -6.0}),
    ("transmission_coupling", ["wrist_2", "wrist_3"], {"viscous": 0.3, "coulomb": 0.4}),
    ("gravity_tilt", None, {"roll": 0.03, "pitch": -0.02}),
)

LOAD = {"mass": 3.0, "mz": 0.3, "Ixx": 0.04, "Iyy": 0.04, "Izz": 0.01}


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


def kinds_of_motion(
    plant: Plant, seed: int
) -> tuple[dict[str, list[Recording]], Payload]:
    """Motions like those learned from, with a payload, at higher speed; the payload."""
    payload = Payload(tuple(range(6)), LOAD)
    loaded = replace(plant, effects=(*plant.effects, payload), servo=None)
    run = partial(simulate, trajectories=2, duration=8.0, seed=seed + 500)
    kinds = {
        "seen before": run(plant, fill=0.6),
        "payload": run(loaded, fill=0.6),
        "faster": run(plant, fill=0.95),
    }
    return kinds, payload


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


def torque(model: DynamicModel, q: Array, v: Array, a: Array) -> Array:
    """Torque of a model at states, shape (N, n), [N·m]."""
    t, ok = np.arange(len(q)) / CONTROL, np.ones(len(q), dtype=bool)
    return model.predict(Motion(t, q, v, a, np.full_like(q, np.nan), ok))
