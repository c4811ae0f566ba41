"""Condition number and CPU time of designed motions, over seeds.

Robots come from the example-robot-data wheel. 24 s starting and ending at rest, 20 Hz
design grid, 0.8 of the file's position, speed and torque limits, no other acceleration
limit. Condition numbers depend on the columns: stated are those of the rigid body in
SI units, not scaled, in its first independent columns, and in those that a pivoted QR
of the same matrix takes; of all columns, friction included (all); and of all brought to
unit length (normalised). "rigid" are the base inertial parameters; "full" adds viscous,
Coulomb, armature and offset columns for each joint. Limits are verified at 200 Hz.
Collision pairs are any two links that are not neighbours and can be apart, and every
link that can reach the floor and the floor, at the height of the arm's foot.

    python benchmarks/excitation.py --seeds 20 --tasks 0 1
"""

from __future__ import annotations

import os

for _name in ("OMP", "OPENBLAS", "MKL"):  # read when numpy loads
    os.environ[f"{_name}_NUM_THREADS"] = "1"

# ruff: noqa: E402
import argparse
import json
import time
import warnings
from collections.abc import Iterator
from importlib.metadata import files
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.effects import effect_class
from hybrid.errors import HybridWarning
from hybrid.excitation import (
    Clearance,
    Condition,
    Floor,
    Fourier,
    Limits,
    design,
    observe,
)
from hybrid.excitation.constraints import Constraint
from hybrid.excitation.observation import FIRST, PIVOTED
from hybrid.excitation.path import uniform
from hybrid.files import atomic_path
from hybrid.plant.noise import Noise
from hybrid.report import Table, markdown_table, provenance, write_results
from hybrid.robot import Robot

ARMS = {
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
}
FRICTION = ("viscous", "coulomb", "armature", "torque_offset")
LEAD = """\
Condition number of designed motions: median (lowest–highest) over seeds, one core. 24 s
starting and ending at rest, 20 Hz design grid, 0.8 × position, speed and torque limits
of the robot file, kept on a grid ten times finer; no limit of acceleration. Columns in
SI units: of the rigid body alone, first independent ones and those by pivoted QR; all,
with friction; all, of unit length (normalised). The determinant is of the information
whitened by typical torque noise. The peer's figures are of the same robot, limits and
grid on a machine like this one, measured beforehand."""
# Robot, columns, what to keep clear of, harmonics, starts, what a peer reached there.
TASKS = (
    ("ur10", "rigid", "", 12, 2, "FIGAROH 13.3–17.4 in 234–250 s"),
    ("ur10", "full", "", 16, 4, "FIGAROH 141–164 or failed in 106–339 s"),
    ("ur10", "rigid", "links", 12, 2, "FIGAROH: rejected after 60 s"),
    ("ur10", "rigid", "links and floor", 12, 2, ""),
    ("panda", "rigid", "", 12, 2, ""),
    ("panda", "rigid", "links", 12, 2, ""),
)
FIGURES = {
    "seconds": "CPU s",
    "first": FIRST,
    "pivoted": PIVOTED,
    "all": "all columns",
    "normalised": "all, normalised",
    "log_det": "log det, whitened",
}
FLOOR = 0.0  # m


def arm(name: str) -> Robot:
    """A robot of the example-robot-data wheel."""
    for file in files("example-robot-data") or ():
        if file.as_posix().endswith(f"example-robot-data/robots/{ARMS[name]}"):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", HybridWarning)  # frozen fingers
                return Robot.load(str(file.locate()))
    raise SystemExit("the example-robot-data wheel is needed")


def obstacles(robot: Robot, kind: str) -> tuple[tuple[Constraint, ...], str]:
    """What a motion keeps clear of, and how many pairs these are, in words."""
    if not kind:
        return (), ""
    links = Clearance.of(robot, Limits.of(robot))
    text = f", {len(set(links.names))} link pairs"
    if "floor" not in kind:
        return (links,), text
    floor = Floor(robot, links.capsules, FLOOR)
    return (links, floor), f"{text} and floor ({len(set(floor.names))} links)"


def run(task: tuple[Any, ...], seeds: int) -> Iterator[dict[str, Any]]:
    """Figures of one task so far, one entry a seed, after every seed."""
    name, columns, kind, order, starts, peer = task
    robot = arm(name)
    names = FRICTION if columns == "full" else ()
    effects = [effect_class(e)((j,)) for j in range(robot.size) for e in names]
    observation = observe(robot.chain, effects)
    family = Fourier(order, 1 / 24)
    title = f"{name}, {columns}, {observation.size} parameters"
    title += obstacles(robot, kind)[1]
    noise = Noise.typical(robot).torque_covariance
    white = observe(robot.chain, effects, covariance=noise)
    found: dict[str, list[float]] = {key: [] for key in (*FIGURES, "excess")}
    for seed in range(seeds):
        start = time.process_time()
        kept, _ = obstacles(robot, kind)
        result = design(
            robot, observation, family, seed=np.random.default_rng(seed),
            criterion=Condition(), starts=starts, constraints=kept,
        )  # fmt: skip
        found["seconds"].append(time.process_time() - start)
        found["first"].append(result.rigid_conditions[FIRST])
        found["pivoted"].append(result.rigid_conditions[PIVOTED])
        found["all"].append(result.condition)
        found["normalised"].append(result.normalised_condition)
        path = result.trajectories[0].path(uniform(family.duration, result.rate))
        gram = white.gram(path, turning_speed=0.0)
        found["log_det"].append(float(np.linalg.slogdet(gram)[1]))
        found["excess"].append(max(result.excess.values()))
        print(title, seed, [round(x[-1], 3) for x in found.values()], flush=True)
        yield {
            "task": title, "harmonics": order, "starts": starts, "peer": peer, **found
        }  # fmt: skip


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--tasks", type=int, nargs="*", default=range(len(TASKS)))
    parser.add_argument("--out", type=Path, default=Path("out/excitation_benchmark"))
    options = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)  # pairs of links in the wrist
    for k in options.tasks:
        command = f"python benchmarks/excitation.py --seeds {options.seeds} --tasks {k}"
        for result in run(TASKS[k], options.seeds):
            write(options.out, result | {"command": command})


def write(folder: Path, result: dict[str, Any]) -> None:
    """Add a task to the results, and write the table of all that are there."""
    path = folder / "results.json"
    tasks = json.loads(path.read_text("utf-8"))["tasks"] if path.exists() else []
    tasks = [x for x in tasks if x["task"] != result["task"]] + [result]
    rows = tuple(row(x) for x in tasks)
    header = ("task", "seeds", *FIGURES.values(), "peer, first independent columns")
    table = Table(header, rows)
    write_results(path, {"provenance": provenance(), "tasks": tasks})
    commands = "".join(f"    {x['command']}\n" for x in tasks)
    text = f"{LEAD}\n\n{markdown_table(table)}\n\n{commands}"
    with atomic_path(folder / "table.md") as temporary:
        temporary.write_text(text, encoding="utf-8")


def row(x: dict[str, Any]) -> tuple[str, ...]:
    """Median, lowest and highest of every figure."""
    figures = [spread(x[key]) for key in FIGURES]
    return x["task"], str(len(x["seconds"])), *figures, x["peer"]


def spread(x: list[float]) -> str:
    """Median, lowest and highest."""
    return f"{np.median(x):.3g} ({min(x):.3g}–{max(x):.3g})"


if __name__ == "__main__":
    main()
