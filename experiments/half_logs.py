"""Do intervals of two halves of a log agree?

A table appears for each of three real arms: the share of parameters whose two estimates
from data that have nothing in common, two halves of a log or two logs, differ by less
than 1.96 standard deviations of the difference. It should be 0.95. Unknowns that either
fit calls undetermined, or held by the robot file, do not count. Laws of friction are
chosen by each half, or, as gains of other laws are other quantities, by both together.

    python experiments/half_logs.py DATA_FOLDER
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from outputs import command_line, write_tables
from real_arms_data import ARMS, Arm

from hybrid import Motion, Robot, identify, read_recordings
from hybrid.effects import Effect
from hybrid.errors import HybridWarning
from hybrid.identification.preparation import linear_effects, prepare
from hybrid.identification.solver import Solver
from hybrid.regression.cross_products import accumulate
from hybrid.regression.intervals import Estimate
from hybrid.regression.problem import build_problem
from hybrid.report import Table, markdown_table
from hybrid.signals import motion_from_recording

STAGES = {
    "rigid": ("rigid",),
    "with friction, each its own laws": ("rigid", "friction"),
}
Found = tuple[tuple[str, ...], Estimate]  # names of the unknowns, and they
SAME = "with friction, the same laws"
HALF = 1.96  # half a normal interval of 95 %, in standard deviations


def pairs(motions: list[Motion]) -> Iterator[tuple[Motion, Motion]]:
    """Two logs as they are, or halves of one: first and last, and its quarters."""
    if len(motions) == 2:
        yield motions[0], motions[1]
        return
    (motion,) = motions
    quarter = np.arange(len(motion.t)) * 4 // len(motion.t)
    for one in ((0, 1), (0, 2), (0, 3)):
        mine = np.isin(quarter, one)
        yield (
            replace(motion, mask=motion.mask & mine),
            replace(motion, mask=motion.mask & ~mine),
        )


def of_laws(robot: Robot, motion: Motion, laws: tuple[Effect, ...], arm: Arm) -> Found:
    """The estimate of one half in given laws, shapes included."""
    solver = Solver(robot, data := prepare([motion], arm.cutoff), "irls", robust=False)
    problem = build_problem(robot.chain, (*linear_effects(robot), *arm.effects))
    solver.plain(products := accumulate(problem, data))
    found = solver.with_effects(solver.best(products), laws)
    return found.problem.base.names, found.estimate


def differences(one: Found, other: Found) -> dict[str, float]:
    """Difference of each parameter that both determine, in standard deviations."""
    found = {}
    (names, first), (others, second) = one, other
    skipped = [{*x.undetermined, *x.held} for x in (first, second)]
    for k, name in enumerate(names):
        j = others.index(name) if name in others else -1
        if j >= 0 and k not in skipped[0] and j not in skipped[1]:
            spread = np.hypot(first.std[k], second.std[j])
            if spread > 0:  # a gain at its bound in all of its blocks has none
                found[name] = float((first.theta[k] - second.theta[j]) / spread)
    return found


def measure(arm: Arm, data: Path) -> Iterator[tuple[str, list[dict[str, float]]]]:
    """Differences of an arm's parameters, by what is fitted and by pair."""
    robot = Robot.load(data / arm.folder / "robot.urdf")
    logs = read_recordings([data / arm.folder], joints=robot.joints)
    motions = [motion_from_recording(x, cutoff=2 * arm.cutoff) for x in logs]
    fitted = partial(identify, robot, effects=arm.effects, cutoff=arm.cutoff)
    for name, stages in STAGES.items():
        fits = [[fitted([x], stages=stages) for x in pair] for pair in pairs(motions)]
        found = [[(x.names, x.estimate) for x in pair] for pair in fits]
        yield name, [differences(*pair) for pair in found]
    laws = fitted(motions, stages=stages).model.effects
    same = [[of_laws(robot, x, laws, arm) for x in pair] for pair in pairs(motions)]
    yield SAME, [differences(*pair) for pair in same]


def main() -> None:
    """Measure all arms, print and write the table."""
    parser = command_line(__doc__, "half_logs")
    parser.add_argument("data", type=Path, help="folder with a folder for each arm")
    args, rows, every = parser.parse_args(), [], {}
    warnings.simplefilter("ignore", HybridWarning)
    for arm in ARMS:
        for name, found in measure(arm, args.data):
            every[f"{arm.name}, {name}"] = found
            shares = [np.mean(np.abs(list(x.values())) < HALF) for x in found]
            counts = ", ".join(str(len(x)) for x in found)
            each = ", ".join(f"{x:.2f}" for x in shares)
            rows.append((arm.name, name, f"{np.mean(shares):.2f}", each, counts))
            print(*rows[-1], flush=True)
    header = ("arm", "fit", "share that agrees", "of each pair", "parameters")
    command = "python experiments/half_logs.py DATA_FOLDER"
    lead = (__doc__ or "").split("\n\n")[1]
    text = f"{lead}\n\n{markdown_table(Table(header, rows))}"
    write_tables(args.out, text, command, differences=every)


if __name__ == "__main__":
    main()
