"""Published chain of designs against ours: condition number of a set of motions.

The table of the COMAN paper: (a) one plain design, (b) iterated designs for
the condition number, (c) iterated designs for the block-weighted condition of the
whitened observation matrix; and (d) ours. All are judged by the condition number of the
whitened matrix of the base inertial parameters in SI units, and share the family
(Fourier, 5 harmonics of 0.1 Hz, at rest at both ends) and the limits (0.8 × position,
speed and acceleration). Published: 329 → 275 → 193 (−41 %).

    python experiments/excitation_chain.py --seeds 3 --arms coman_like
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from excitation_arms import arm
from excitation_chain_report import MOTIONS, write

from hybrid.excitation import BlockCondition, Condition, Fourier, Limits, observe
from hybrid.excitation.constraints import MotionLimits
from hybrid.excitation.design import design
from hybrid.excitation.program import MotionProgram
from hybrid.excitation.published import iterated_design, set_condition
from hybrid.plant.noise import Noise

ROOT = Path(__file__).parents[1]
FAMILY, RATE = Fourier(5, 0.1), 20.0


def main() -> None:
    """Run all arms and seeds; the table is written after each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--arms", nargs="+", default=["coman_like", "ur10", "panda"])
    parser.add_argument("--out", type=Path, default=ROOT / "reports/excitation_chain")
    options = parser.parse_args()
    runs = {}
    for seed in range(options.seeds):
        for name in options.arms:
            runs.setdefault(name, []).append(run(arm(name), seed))
            print(name, seed, runs[name][-1], flush=True)
            write(options.out, options.seeds, options.arms, runs)


def run(robot, seed):
    """Condition and CPU seconds of each row, shape (5, 2)."""
    rng = np.random.default_rng(seed)
    noise = Noise.typical(robot).torque_covariance
    white, plain = observe(robot.chain, covariance=noise), observe(robot.chain)
    # The paper limits the motion, not the torque.
    limits = replace(Limits.of(robot), torque=np.full(robot.size, np.inf))
    start = MotionProgram(
        plain, Condition(), FAMILY, (MotionLimits(limits, robot.joints),), limits,
        np.zeros((white.size, white.size)), RATE, 1.0, 1e-3,
    )  # fmt: skip
    block = replace(start, observation=white)
    block = replace(block, criterion=BlockCondition(white.gravity_columns))
    found = []
    for program, count in ((start, 1), (start, MOTIONS), (block, MOTIONS)):
        begin = time.process_time()
        motions = iterated_design(program, trajectories=count, rng=rng)
        seconds = time.process_time() - begin
        found.append((set_condition(white, motions, RATE), seconds))
    for count in (1, MOTIONS):
        begin = time.process_time()
        ours = design(
            robot, white, FAMILY, rng=rng, criterion=Condition(), limits=limits,
            trajectories=count, starts=3,
        )  # fmt: skip
        seconds = time.process_time() - begin
        found.append((set_condition(white, ours.trajectories, RATE), seconds))
    return found


if __name__ == "__main__":
    main()
