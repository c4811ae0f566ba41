"""Gains tuned in a simulator, run on the plant: which simulator serves?

A table appears: RMS tracking error on the plant of short slow strokes, there and back,
that no tuning has seen. A soft PD controller feeds forward the links' torque and, at
each joint, friction (of the sign of speed and of speed) and ripple (a sine and a cosine
of known period), whose sizes are tuned in a simulator with the same budget: in the
plant itself, in the nominal file, in a file with plain least squares, in the MJCF file
that is exported of our identification, and in the same with the effects that the file
says it lacks. The links' torque is that of the same simulator.
The plant has a payload, rotors, Stribeck, quadratic and load-dependent friction, and
ripple, of one to two times the usual size; its logs are noisy, half of them slow, and
of other motion than the strokes. It steps by another integrator than the files.

    python experiments/tuned_controller.py --seeds 10
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from coman import ROOT
from measures import measures_table
from outputs import captioned, command_line, write_tables
from rich.console import Console
from tuned_controller_task import (
    RATE,
    SUBSTEPS,
    World,
    fed_forward,
    in_file,
    strokes,
    tracked,
    tuned,
)

from hybrid import Recording, Robot, identify, simulate
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.exports import model_simulator
from hybrid.plant import Plant
from hybrid.plant.joint_fields import curves
from hybrid.plant.lockstep import Lockstep
from hybrid.plant.scale import joint_scales
from hybrid.report import terminal_table
from hybrid.robot.chain import Chain

TRUTH = "payload,armature,stribeck,nonlinear_viscous,load_friction,torque_ripple"
METHODS = "truth", "nominal", "plain LS", "ours", "ours + what the file lacks"
LEAST_SQUARES = {"stages": ("rigid",), "estimator": "ls"}
SLOW = 0.1  # of the limits


def plant_of(robot: Robot, rng: np.random.Generator) -> Plant:
    """The arm as it is."""
    effects = [
        e.at({g.name: e.values[g.name] * size for g in e.gains})
        for e in effects_from_text(TRUTH, robot.joints, joint_scales(robot))
        for size in [rng.uniform(1.0, 2.0)]
    ]
    return Plant(robot, effects, step=1 / (RATE * SUBSTEPS), integrator="euler")


def measure(seed: int) -> list[float]:
    """Errors on the plant of controllers tuned in all simulators, for one seed."""
    robot, rng = Robot.load(ROOT / "models" / "planar.xml"), np.random.default_rng(seed)
    plant, unit = plant_of(robot, rng), 0.1 * robot.tau_max
    logs = [
        log
        for k, fill in enumerate((0.7, SLOW))
        for log in simulate(plant, trajectories=2, seed=2 * seed + k, fill=fill)
    ]
    practice, test = strokes(robot, rng), strokes(robot, rng)
    feeds = []
    with TemporaryDirectory() as folder:
        for world, links in simulators(plant, logs, Path(folder)):
            gains = tuned(world, links, unit, plant.servo, practice)
            feeds.append(fed_forward(links, unit, test, gains[None])[0])
    off = tracked(stepped(plant), plant.servo, test, np.stack(feeds))
    return (1e3 * np.sqrt(np.mean(off**2, axis=(1, 2, 3)))).tolist()


def simulators(
    plant: Plant, logs: list[Recording], folder: Path
) -> Iterator[tuple[World, Chain]]:
    """Where a controller is tuned, and the links that it knows."""
    robot, gravity = plant.robot, plant.robot.chain.gravity
    changes = (e.rigid_change(robot.size, gravity) for e in plant.effects)
    links = robot.chain.inertial + sum(x[0] for x in changes if x is not None)
    yield stepped(plant), robot.with_inertial(links).chain
    yield in_file(Path(robot.path), robot.joints), robot.chain
    for options in (LEAST_SQUARES, {}):
        model = identify(robot, logs, consistent=True, **options).model  # type: ignore[arg-type]
        made, file = model_simulator(model, folder=folder), folder / "arm.xml"
        made.write(file)
        yield in_file(file, robot.joints), made.robot.chain
    every = Plant(made.robot, made.rest, step=plant.step)
    yield stepped(every), made.robot.chain


def stepped(plant: Plant) -> World:
    """A plant with its effects and the curves of its file."""
    laws = [*plant.effects, *curves(plant.robot)]
    return lambda q: Lockstep(plant.arm, laws, q)


def main() -> None:
    """Measure all seeds, print the table, write the report."""
    parser = command_line(__doc__, "tuned_controller")
    parser.add_argument("--seeds", type=int, default=10)
    args, console, runs = parser.parse_args(), Console(width=200), []
    warnings.simplefilter("ignore", HybridWarning)  # a rung that was left out
    for seed in range(args.seeds):
        runs.append(measure(seed))
        console.print(seed, np.round(runs[-1], 2).tolist())
    table = measures_table(METHODS, {"error": np.array(runs)}, {"error": "mrad"})
    command = f"python experiments/tuned_controller.py --seeds {args.seeds}"
    write_tables(args.out, captioned(table), command, runs=runs)
    console.print(terminal_table(table))


if __name__ == "__main__":
    main()
