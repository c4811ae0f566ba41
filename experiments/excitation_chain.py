"""Published chain of designs against ours: condition number of a set of motions.

The table of the COMAN paper: (a) one plain design, (b) iterated designs for the
condition number, (c) for the block-weighted condition of the whitened matrix, columns
weighed by std/mean of their entries, as printed and of their magnitudes (between two
rests an acceleration has no mean); and (d) ours: one motion, three chosen together, and
one of another family, of higher frequencies. All are judged by the condition number of
the whitened matrix of the base inertial parameters in SI units, first independent
columns. Published: 329 → 275 → 193 (−41 %).

    python experiments/excitation_chain.py --seeds 5 --arms coman_like
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from excitation_arms import arm
from excitation_chain_report import MOTIONS, write
from excitation_published import (
    BlockCondition,
    BlockProgram,
    gravity_columns,
    iterated_design,
    set_condition,
)

from hybrid.excitation import Condition, Fourier, Limits, Spline, design, observe
from hybrid.excitation.constraints import MotionLimits
from hybrid.excitation.program import MotionProgram
from hybrid.plant.noise import Noise

FAMILY, SPLINES, RATE = Fourier(5, 0.1), Spline(10.0, 20), 20.0
OURS = ((FAMILY, 1, 3), (FAMILY, MOTIONS, 2), (SPLINES, 1, 2))  # motions, starts


def main() -> None:
    """Run all arms and seeds; the table is written after each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--arms", nargs="+", default=["coman_like", "ur10", "panda"])
    parser.add_argument("--out", type=Path, default=Path("out/excitation_chain"))
    options = parser.parse_args()
    runs = {}
    for seed in range(options.seeds):
        for name in options.arms:
            runs.setdefault(name, []).append(run(arm(name), seed))
            print(name, seed, runs[name][-1], flush=True)
            write(options.out, options.seeds, options.arms, runs)


def run(robot, seed):
    """Condition and CPU seconds of each row, shape (7, 2)."""
    rng = np.random.default_rng(seed)
    noise = Noise.typical(robot).torque_covariance
    white, plain = observe(robot.chain, covariance=noise), observe(robot.chain)
    # The paper limits the motion, not the torque.
    limits = replace(Limits.of(robot), torque=np.full(robot.size, np.inf))
    start = MotionProgram(
        plain, Condition(), FAMILY, (MotionLimits(limits, robot.joints),), limits,
        np.zeros((white.size, white.size)), RATE, 1.0, 1e-3,
    )  # fmt: skip
    size = white.size + 1
    block = BlockProgram(
        white, BlockCondition(gravity_columns(white)), FAMILY, start.constraints,
        limits, np.zeros((size, size)), RATE, 1.0, 1e-3,
    )  # fmt: skip
    begin = time.process_time()
    first = iterated_design(start, trajectories=1, rng=rng)
    middle = time.process_time()
    more = replace(start, known=start.information(start.point(first[0])))
    more = first + iterated_design(more, trajectories=MOTIONS - 1, rng=rng)
    end = time.process_time()
    found = [(first, middle - begin), (more, end - begin)]
    for signed in (True, False):
        begin = time.process_time()
        weighted = replace(block, signed=signed)
        best = iterated_design(weighted, trajectories=MOTIONS, rng=rng)
        found.append((best, time.process_time() - begin))
    for family, count, starts in OURS:
        begin = time.process_time()
        ours = design(
            robot, white, family, seed=rng, criterion=Condition(), limits=limits,
            trajectories=count, starts=starts, together=True,
        )  # fmt: skip
        found.append((ours.trajectories, time.process_time() - begin))
    return [(set_condition(white, motions, RATE), s) for motions, s in found]


if __name__ == "__main__":
    main()
