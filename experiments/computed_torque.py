"""Computed torque: how well does a simulator's own inverse dynamics drive the plant?

A table appears: RMS tracking error of fast moves from rest to rest, with a payload and
stiction of one to three times the usual size, under the torque that a simulator asks
for along the move and a PD controller of a quarter of the usual bandwidth. The
simulators are the nominal file, plain least squares, the MJCF file that is exported of
our identification, alone and with what is exported beside it, and the plant's own laws.
The plant steps at 4 kHz by another integrator, and its friction (Stribeck, quadratic)
is none that the file can say. Without disturbance, and with one that nobody can know.

    python experiments/computed_torque.py --seeds 10
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from coman import ROOT
from computed_torque_task import RATE, SUBSTEPS, coloured, moves, tracked
from measures import measures_table
from outputs import command_line
from rich.console import Console

from hybrid import Robot, identify, simulate
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.exports import model_simulator
from hybrid.exports.simulator.check import file_torque
from hybrid.files import atomic_path
from hybrid.model.declared import declared_effects
from hybrid.plant import Plant
from hybrid.plant.scale import joint_scales
from hybrid.report import markdown_table, numbers_table, provenance, write_results

TRUTH = "payload,stribeck,nonlinear_viscous,armature"
METHODS = ("truth", "nominal", "plain LS", "ours, exported", "with the rest")
MEASURES = dict.fromkeys(("undisturbed", "disturbed"), "mrad")
DISTURBANCE = 0.02  # of rated torque


def measure(seed: int) -> dict[str, list[float]]:
    """Errors of all simulators on the moves of one seed."""
    robot, rng = Robot.load(ROOT / "models" / "planar.xml"), np.random.default_rng(seed)
    scales = joint_scales(robot)
    effects = [
        e.at({g.name: e.values[g.name] * size for g in e.gains})
        for e in effects_from_text(TRUTH, robot.joints, scales)
        for size in [rng.uniform(1.0, 3.0)]
    ]
    plant = Plant(robot, effects, step=1 / (RATE * SUBSTEPS), integrator="euler")
    model = identify(robot, simulate(plant, seed=seed), consistent=True).model
    laws = (*declared_effects(robot), *effects)
    true = replace(
        model, inertial=robot.chain.inertial, effects=laws, remainder=None, simpler={}
    )
    ways, found = moves(robot, rng), dict[str, list[float]]()
    with TemporaryDirectory() as folder:
        model_simulator(model, folder=folder).write(Path(folder, "arm.xml"))
        torques = [
            [true.predict(m) for m in ways],
            [file_torque(robot, model, m) for m in ways],
            [model.simpler["LS"].predict(m) for m in ways],
            [file_torque(Path(folder, "arm.xml"), model, m) for m in ways],
            [model.predict(m) for m in ways],
        ]
    for name, level in (("undisturbed", 0.0), ("disturbed", DISTURBANCE)):
        size = level * robot.tau_max
        push = np.stack([size * coloured(len(m.t), robot.size, rng) for m in ways])
        found[name] = tracked(plant, ways, np.array(torques), push).tolist()
    return found


def main() -> None:
    """Measure all seeds, print the table, write the report."""
    parser = command_line(__doc__, "computed_torque")
    parser.add_argument("--seeds", type=int, default=10)
    args, console, runs = parser.parse_args(), Console(width=160), []
    warnings.simplefilter("ignore", HybridWarning)  # a rung that was left out
    for seed in range(args.seeds):
        runs.append(measure(seed))
        console.print(seed, {k: np.round(x, 2).tolist() for k, x in runs[-1].items()})
    values = {name: np.array([run[name] for run in runs]) for name in MEASURES}
    table = measures_table(METHODS, values, MEASURES)
    command = f"python experiments/computed_torque.py --seeds {args.seeds}"
    with atomic_path(args.out / "table.md") as path:
        text = f"{table.caption}.\n\n{markdown_table(table)}\n    {command}\n"
        path.write_text(text, encoding="utf-8")
    content = {"provenance": provenance(command=command), "runs": runs}
    write_results(args.out / "results.json", content)
    console.print(numbers_table(table))


if __name__ == "__main__":
    main()
