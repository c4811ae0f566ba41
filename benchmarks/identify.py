"""Speed and memory of a whole identification, beside a Python loop and FIGAROH.

Regressor, reduction, reweighted least squares to convergence and intervals for a
six-axis arm, on one core, without leaving out a sample. Every length runs in a process
of its own, so that its peak memory is its own; times are processor times, the least of
some runs, so that other work on the machine matters little. The loop fills the inertial
columns alone, and FIGAROH solves ordinary least squares: both do less. FIGAROH takes
part where the extra ``bench`` is installed. The verb, with all its stages, reads a CSV
file of a minute of the arm at 1 kHz.

    python benchmarks/identify.py
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL"):  # read when numpy loads
    os.environ[f"{_name}_NUM_THREADS"] = "1"

# ruff: noqa: E402
import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin
from figaroh_task import identify_by_figaroh
from tables import length_table, ratio_table
from task import ARM, full_model, identify_plainly, random_motion

from hybrid.dynamics import regressor
from hybrid.files import atomic_path
from hybrid.plant import load_truth, simulate
from hybrid.recording import write
from hybrid.report import markdown_table, provenance, write_results
from hybrid.robot import Robot

REPORT = Path(__file__).parents[1] / "reports" / "benchmarks"
TRUTH = Path(__file__).parents[1] / "models" / "coman_truth.yaml"
LENGTHS = (100_000, 200_000, 400_000, 1_000_000)


def ours(samples: int, repeats: int) -> dict[str, Any]:
    """Times [s] and peak memory [MiB] of this process; run it in a fresh one."""
    robot = Robot.load(ARM)
    motion = random_motion(robot, samples)
    before = _peak()
    runs = [identify_plainly(robot, motion) for _ in range(repeats)]
    steps = {k: min(run[1][k] for run in runs) for k in runs[0][1]}
    estimate, after = runs[0][0], _peak()
    model = full_model(robot, motion)
    predicting = [_seconds(lambda: model.predict(motion)) for _ in range(repeats)]
    return {
        "samples": samples,
        "seconds": sum(steps.values()),
        "steps": steps,
        "peak_mebibytes": after,
        "before_mebibytes": before,
        "iterations": estimate.iterations,
        "converged": estimate.converged,
        "predict_seconds": min(predicting),
    }


def others(samples: int, repeats: int) -> dict[str, Any]:
    """Seconds of the regressors, and of FIGAROH's steps; also to be run afresh."""
    robot = Robot.load(ARM)
    motion = random_motion(robot, samples)
    q, v, a = motion.q, motion.v, motion.a
    model, n = robot.pinocchio(), robot.size
    data, kept = model.createData(), np.empty((samples, n, 10 * n))

    def loop() -> None:
        for k in range(samples):
            kept[k] = pin.computeJointTorqueRegressor(model, data, q[k], v[k], a[k])

    def batched() -> None:
        regressor(robot.chain, q, v, a)

    # In turns, so that a busy moment hits both.
    times = [(_seconds(batched), _seconds(loop)) for _ in range(repeats)]
    least = np.min(times, axis=0).tolist()
    theirs = identify_by_figaroh(robot, motion)
    found = {"regressor": least[0], "loop": least[1], "figaroh": theirs}
    return found | {"peak_mebibytes": _peak()}


def verb(samples: int, repeats: int) -> dict[str, Any]:
    """Least processor time of ``hybrid identify`` on a log at 1 kHz, with loading."""
    _, plant = load_truth(TRUTH)
    plant = replace(plant, log_rate=1000.0)
    (log,) = simulate(plant, trajectories=1, duration=samples / 1000.0, seed=0)
    times = []
    with tempfile.TemporaryDirectory() as folder:
        write(log, path := Path(folder) / "log.csv")
        command = [sys.executable, "-m", "hybrid", "identify", "--robot", str(ARM)]
        command += ["--recordings", str(path), "--out", f"{folder}/model.json"]
        for _ in range(repeats):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            user, system = (
                getattr(after, x) - getattr(before, x) for x in ("ru_utime", "ru_stime")
            )
            times.append(user + system)
    return {"samples": samples, "seconds": min(times)}


def _seconds(run: Callable[[], Any]) -> float:
    start = process_time()
    run()
    return process_time() - start


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024  # Linux: KiB


def _afresh(what: str, samples: int, repeats: int) -> dict[str, Any]:
    """The result of a function above in a process of its own."""
    command = [sys.executable, __file__, "--only", what, str(samples), str(repeats)]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Measure, print, and write the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        what, samples, repeats = options.only
        print(
            json.dumps(
                {"ours": ours, "others": others, "verb": verb}[what](
                    int(samples), int(repeats)
                )
            )
        )
        return
    runs = [_afresh("ours", length, options.repeats) for length in LENGTHS]
    other = _afresh("others", LENGTHS[0], options.repeats)
    whole = _afresh("verb", 60_000, options.repeats)
    command = f"python benchmarks/identify.py --repeats {options.repeats}"
    tables = (ratio_table(runs[0], other), length_table(runs))
    text = "\n".join(f"{x.caption}.\n\n{markdown_table(x)}" for x in tables)
    text += (
        f"\nThe verb on {whole['samples']:,} samples at 1 kHz, from a CSV file: "
        f"{whole['seconds']:.2f} s.\n"
    )
    print(text)
    content = {"provenance": provenance(command=command), "runs": runs, "others": other}
    content["verb"] = whole
    write_results(REPORT / "identify.json", content)
    with atomic_path(REPORT / "identify.md") as path:
        path.write_text(f"{text}\n    {command}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
