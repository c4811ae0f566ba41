"""Time of ``DynamicModel.predict`` on one core: one sample, and a batch.

A six-axis arm with the effects of the documented truth, and a public seven-axis arm
with rotors, dry, viscous and Stribeck friction at every joint; each also with a mixture
of twenty components at every joint. Processor time: median and worst of runs of a
hundred calls with one sample, and of runs with a batch.

    python benchmarks/predict.py --json reports/benchmarks/predict.json
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import files
from pathlib import Path
from typing import Any

import numpy as np
from tables import show

from hybrid import DynamicModel, Effect, Robot
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.effects import effect_class
from hybrid.plant import load_truth
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem
from hybrid.signals import Motion

TRUTH = Path(__file__).parents[1] / "models" / "coman_truth.yaml"
PANDA = "example-robot-data/robots/panda_description/urdf/panda.urdf"
FRICTION = ("armature", "coulomb", "viscous", "stribeck")
BATCH, RUNS, CALLS, COMPONENTS = 50_000, 40, 100, 20


def models() -> dict[str, DynamicModel]:
    """Both arms with and without mixtures."""
    _, plant = load_truth(TRUTH)
    (urdf,) = (x for x in files("example-robot-data") or () if str(x).endswith(PANDA))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its fingers stay as they are
        panda = Robot.load(urdf.locate())
    scales = joint_scales(panda)
    friction = [
        effect_class(name).typical((j,), scales)
        for name in FRICTION
        for j in range(panda.size)
    ]
    arms: dict[str, tuple[Robot, tuple[Effect, ...]]] = {
        "6 axes": (plant.robot, tuple(plant.effects)),
        "7 axes": (panda, tuple(friction)),
    }
    found = {}
    for name, (robot, effects) in arms.items():
        base, links = build_problem(robot.chain, ()).base, robot.chain.inertial
        model = DynamicModel(robot, base, effects, inertial=links)
        found[f"{name}, {len(effects)} effects"] = model
        mixed = replace(model, remainder=mixtures(robot.size))
        found[f"{name}, {len(effects)} effects, {COMPONENTS} components a joint"] = (
            mixed
        )
    return found


def mixtures(n: int) -> ArmRemainder:
    """A mixture at each joint over its position and speed."""
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(3000, 2)), rng.normal(size=(3000, 1))
    learned = fit_gmr(x, y, components=COMPONENTS, covariance_floor=1e-2)
    return ArmRemainder(
        n, tuple(JointRemainder(j, (j,), (j,), learned) for j in range(n))
    )


def measure(model: DynamicModel) -> dict[str, float]:
    """Microseconds for one sample, and millions of samples a second in a batch."""
    n, rng, found = model.robot.size, np.random.default_rng(1), {}
    for rows, calls in ((1, CALLS), (BATCH, 1)):
        q, v, a = rng.uniform(-1, 1, (3, rows, n))
        t, ok = np.arange(rows) * 0.001, np.ones(rows, dtype=bool)
        motion = Motion(t, q, v, a, np.full_like(q, np.nan), ok)
        times = runs(lambda m=motion: model.predict(m), calls)
        if rows == 1:
            found["one sample, median [µs]"] = 1e6 * float(np.median(times))
            found["one sample, worst [µs]"] = 1e6 * max(times)
        else:
            found["batch, median [M/s]"] = rows / float(np.median(times)) / 1e6
            found["batch, worst [M/s]"] = rows / max(times) / 1e6
    return found


def runs(call: Callable[[], Any], calls: int) -> list[float]:
    """Processor seconds of a call in each run of some."""
    call()
    times = []
    for _ in range(RUNS):
        start = time.process_time()
        for _ in range(calls):
            call()
        times.append((time.process_time() - start) / calls)
    return times


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json")
    args = parser.parse_args()
    found = {name: measure(model) for name, model in models().items()}
    show(found, command="python benchmarks/predict.py", path=args.json)


if __name__ == "__main__":
    main()
