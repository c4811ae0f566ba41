"""Time to predict torque: Python, the tape, the compiled header, ONNX.

One sample and a batch, of a six-axis arm: its rigid body, with the effects of the
documented truth, and with a mixture of twenty components at every joint. Processor time
of one core, beside that of pinocchio's recursive Newton–Euler in the same run.

    python benchmarks/export.py --json reports/benchmarks/export.json
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pinocchio as pin
from tables import show

from hybrid import DynamicModel
from hybrid.compensator.arm_remainder import ArmRemainder, JointRemainder
from hybrid.compensator.gmr_fit import fit_gmr
from hybrid.exports import export
from hybrid.model.program import program_from_model
from hybrid.plant import load_truth
from hybrid.regression.problem import build_problem
from hybrid.signals import Motion

sys.path.insert(0, str(Path(__file__).parents[1] / "experiments"))

from compiled_model import CompiledModel  # noqa: E402

TRUTH = Path(__file__).parents[1] / "models" / "coman_truth.yaml"
BATCH = 50_000


def models() -> dict[str, DynamicModel]:
    """The arm with more and more of its parts."""
    _, plant = load_truth(TRUTH)
    robot, rng = plant.robot, np.random.default_rng(0)
    x, y = rng.normal(size=(3000, 2)), rng.normal(size=(3000, 1))
    mixture = fit_gmr(x, y, components=20, covariance_floor=1e-2)
    parts = tuple(JointRemainder(j, (j,), (j,), mixture) for j in range(robot.size))
    base, links = build_problem(robot.chain, ()).base, robot.chain.inertial
    effects, learned = tuple(plant.effects), ArmRemainder(robot.size, parts)
    return {
        "rigid body": DynamicModel(robot, base, inertial=links),
        "+ effects": DynamicModel(robot, base, effects, inertial=links),
        "+ mixtures": DynamicModel(robot, base, effects, learned, inertial=links),
    }


def spent(call: Callable[[], Any], *, least: float = 0.2) -> float:
    """Processor seconds of a call, mean over a while."""
    call()
    start, count = time.process_time(), 0
    while (now := time.process_time() - start) < least:
        call()
        count += 1
    return now / count


def measure(model: DynamicModel) -> dict[str, float]:
    """Microseconds for one sample, and millions of samples a second in a batch."""
    import onnxruntime

    n, rng = model.robot.size, np.random.default_rng(1)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    with TemporaryDirectory() as name:
        export(model, name, format="onnx")
        path = str(Path(name) / f"{model.robot.name}.onnx")
        session = onnxruntime.InferenceSession(path, options)
    program, compiled = program_from_model(model), CompiledModel(model)
    tree = model.robot.pinocchio()
    data = tree.createData()
    found = {}
    for rows in (1, BATCH):
        q, v, a = rng.uniform(-1, 1, (3, rows, n))
        ok, t = np.ones(rows, dtype=bool), np.arange(rows) * 0.001
        motion = Motion(t, q, v, a, np.full_like(q, np.nan), ok)
        calls: dict[str, Callable[[], Any]] = {
            "predict": lambda m=motion: model.predict(m),
            "tape": lambda x=(q, v, a): program.run(*x),
            "compiled": lambda x=(q, v, a): compiled.predict(*x),
            "onnx": lambda x={"q": q, "v": v, "a": a}: session.run(None, x),
        }
        if rows == 1:
            calls["pinocchio"] = lambda x=(q[0], v[0], a[0]): pin.rnea(tree, data, *x)
        for name, call in calls.items():
            seconds = spent(call)
            one = rows == 1
            key = f"{name} one sample [µs]" if one else f"{name} batch [M/s]"
            found[key] = 1e6 * seconds if one else rows / seconds / 1e6
    return found


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json")
    args = parser.parse_args()
    found = {name: measure(model) for name, model in models().items()}
    show(found, command="python benchmarks/export.py", path=args.json)


if __name__ == "__main__":
    main()
