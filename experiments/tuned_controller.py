"""Two controllers made in a simulator and run on the plant: which simulator serves?

A table appears: RMS tracking error on the plant of fast moves that no tuning has seen,
of controllers made in the nominal file, in a file with plain least squares, in the MJCF
file that is exported of our identification, and in the plant itself. One feeds forward
the simulator's own inverse dynamics, to a soft PD controller. The gains of the other
are tuned in the simulator, with the same budget: stiffness and damping, no stiffer than
that, and multiples of the nominal file's weight and inertia, of speed and of its sign.
The plant has a payload, rotors, Stribeck, quadratic and load-dependent friction, and
ripple, of one to two times the usual size; its logs are noisy, and of other motion than
the moves. It steps by another integrator than the files. Without disturbance, and with
one that nobody can know.

    python experiments/tuned_controller.py --seeds 10
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from coman import ROOT
from measures import measures_table
from outputs import command_line
from rich.console import Console
from tuned_controller_task import (
    RATE,
    SUBSTEPS,
    FileArms,
    coloured,
    fed_forward,
    moves,
    tracked,
)
from tuned_controller_task import tuned as tuned_in

from hybrid import Robot, identify, simulate
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.exports import model_simulator
from hybrid.exports.simulator.check import file_torque
from hybrid.files import atomic_path
from hybrid.model.declared import declared_effects
from hybrid.plant import Plant
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.scale import joint_scales
from hybrid.report import markdown_table, numbers_table, provenance, write_results

TRUTH = "payload,armature,stribeck,nonlinear_viscous,load_friction,torque_ripple"
METHODS = ("truth", "nominal", "plain LS", "ours")
KINDS = "tuned", "tuned, disturbed", "fed forward", "fed forward, disturbed"
MEASURES = dict.fromkeys(KINDS, "mrad")
LEAST_SQUARES = {"stages": ("rigid",), "estimator": "ls"}
DISTURBANCE = 0.02  # of rated torque


def plant_of(robot: Robot, rng: np.random.Generator) -> Plant:
    """The arm as it is."""
    effects = [
        e.at({g.name: e.values[g.name] * size for g in e.gains})
        for e in effects_from_text(TRUTH, robot.joints, joint_scales(robot))
        for size in [rng.uniform(1.0, 2.0)]
    ]
    return Plant(robot, effects, step=1 / (RATE * SUBSTEPS), integrator="euler")


def measure(seed: int) -> dict[str, list[float]]:
    """Errors on the plant of controllers made in all simulators, for one seed."""
    robot, rng = Robot.load(ROOT / "models" / "planar.xml"), np.random.default_rng(seed)
    plant = plant_of(robot, rng)
    logs = simulate(plant, seed=seed)
    practice, test = moves(robot, rng), moves(robot, rng)
    with TemporaryDirectory() as folder:
        files = [Path(robot.path)]
        for name, options in (("ls", LEAST_SQUARES), ("ours", {})):
            model = identify(robot, logs, consistent=True, **options).model
            files.append(Path(folder, f"{name}.xml"))
            model_simulator(model, folder=folder).write(files[-1])
        torques = [[file_torque(x, model, m) for m in test] for x in files]
        worlds = [lambda q: Lockstep(plant.arm, plant.effects, q)]
        worlds += [lambda q, x=x: FileArms(x, robot.joints, q) for x in files]
        servo, soft = plant.servo, np.ones((len(worlds), 2, robot.size))
        gains = np.array([tuned_in(x, robot, servo, practice) for x in worlds])
    laws = (*declared_effects(robot), *plant.effects)
    true = replace(
        model, inertial=robot.chain.inertial, effects=laws, remainder=None, simpler={}
    )
    own = np.array([[true.predict(m) for m in test], *torques])
    feeds, found = fed_forward(robot, test, gains), dict[str, list[float]]()
    for kind in KINDS:
        level = DISTURBANCE * ("disturbed" in kind) * robot.tau_max
        push = np.stack([level * coloured(len(m.t), robot.size, rng) for m in test])
        feed, pd = (feeds, gains[:, :2]) if "tuned" in kind else (own, soft)
        off = tracked(worlds[0], servo, test, feed + push, pd)
        found[kind] = (1e3 * np.sqrt(np.mean(off**2, axis=(1, 2, 3)))).tolist()
    return found


def main() -> None:
    """Measure all seeds, print the table, write the report."""
    parser = command_line(__doc__, "tuned_controller")
    parser.add_argument("--seeds", type=int, default=10)
    args, console, runs = parser.parse_args(), Console(width=200), []
    warnings.simplefilter("ignore", HybridWarning)  # a rung that was left out
    for seed in range(args.seeds):
        runs.append(measure(seed))
        console.print(seed, {k: np.round(x, 2).tolist() for k, x in runs[-1].items()})
    values = {name: np.array([run[name] for run in runs]) for name in MEASURES}
    table = measures_table(METHODS, values, MEASURES)
    command = f"python experiments/tuned_controller.py --seeds {args.seeds}"
    with atomic_path(args.out / "table.md") as path:
        text = f"{table.caption}.\n\n{markdown_table(table)}\n    {command}\n"
        path.write_text(text, encoding="utf-8")
    content = {"provenance": provenance(command=command), "runs": runs}
    write_results(args.out / "results.json", content)
    console.print(numbers_table(table))


if __name__ == "__main__":
    main()
