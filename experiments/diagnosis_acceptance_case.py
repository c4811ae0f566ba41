"""The plants of ``diagnosis_acceptance.py``: what they have, and one run of each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from blind.sysid import has_sysid
from diagnosis_acceptance_report import Run
from diagnosis_acceptance_sysid import fit_by_sysid

from hybrid import Robot, simulate
from hybrid.diagnosis.answer.fixed import fixed_model, fixed_simulator
from hybrid.diagnosis.answer.motion_gap import with_motion_gap
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects import Effect
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identification import DynamicModel
from hybrid.plant import Noise, Plant

ARM = Path(__file__).parents[1] / "models" / "coman_like.xml"
JOINTS = {"torque_ripple": (1, 2), "stribeck": (0, 1, 2), "nothing": ()}


def truth(kind: str, robot: Robot, rng: np.random.Generator) -> list[Effect]:
    """Effects of a plant; sizes are shares of rated torque."""
    effects: list[Effect] = []
    for j in JOINTS[kind]:
        size = robot.tau_max[j] * rng.uniform(0.02, 0.04)
        if kind == "torque_ripple":
            turn, periods = rng.uniform(0, 2 * np.pi), float(rng.integers(8, 30))
            wave = {"sine": size * np.sin(turn), "cosine": size * np.cos(turn)}
            effects.append(TorqueRipple((j,), {**wave, "periods": periods}))
        else:
            speed = rng.uniform(0.04, 0.12)
            effects.append(Stribeck((j,), {"level": size, "velocity": speed}))
    return effects


def left(gap: Gap, model: DynamicModel, joints: list[int]) -> float:
    """RMS that a model leaves of a motion's torque at some joints, [N·m]."""
    ((motion, _, sampler),) = gap
    off = gap.left + sampler(motion.tau - model.predict(motion))
    return float(np.sqrt(np.mean(off[:, joints][gap.moving[:, joints]] ** 2)))


def run(kind: str, seed: int, quiet: bool) -> Run:
    """One plant: diagnose its first motion, score on its second."""
    robot = Robot.load(ARM)
    effects = truth(kind, robot, np.random.default_rng([seed, len(kind)]))
    servo, noise = Plant(robot, effects).servo, Noise.typical(robot)
    assert servo is not None
    if quiet:
        noise = replace(noise, torque_covariance=0.01 * noise.torque_covariance)
    servo = replace(servo, feedforward=None)
    plant = Plant(robot, effects, servo=servo, noise=noise)
    log, other = simulate(plant, trajectories=2, duration=10.0, seed=seed)
    start = process_time()
    result = examine(robot, [log])
    middle = process_time()
    result = with_motion_gap(result, np.random.default_rng(seed))
    seconds = middle - start, process_time() - middle
    gap = measure_gap(robot, [other], cutoff=result.gap.cutoff)
    joints = list(JOINTS[kind]) or list(range(robot.size))
    models = {
        "before": fixed_model(result.gap, robot, ()),
        "after": fixed_model(result.gap, *fixed_simulator(result)),
        "floor": fixed_model(result.gap, robot, effects),
    }
    fitted = fit_by_sysid(robot, plant, log) if has_sysid() and not quiet else None
    if fitted is not None:
        models["sysid"] = fixed_model(result.gap, fitted.robot, ())
    rms = {name: left(gap, model, joints) for name, model in models.items()}
    return Run(
        kind, seed, quiet, tuple(effects), result.diagnosis, rms, seconds, fitted
    )
