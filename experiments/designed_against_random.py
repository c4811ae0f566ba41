"""Does a designed motion win? Held-out torque error after it and after a random one.

For each seed an arm moves for 10 s along a random Fourier series, scaled to touch the
limits, and along our default design: the same family (5 harmonics of 0.1 Hz), duration
and limits (0.8 × those of the file, the torque of the nominal arm included). The same
identification follows both, plain and weighted least squares and with friction, and
eight random motions that neither knows are predicted. The plants are not what the
criterion assumes: links differ, friction has memory and another law, torque repeats
with periods that the criterion does not list. Those of UR10 and SCARA are drawn anew
for each seed. Beside them is what plain least squares leave that have seen the eight
motions themselves. Each fit takes the cut-off of the positions from its own log, as the
verb does, unless ``--cutoff`` sets one; all are scored on what the plant does without
noise, read once, so that the score knows of no cut-off.

    python experiments/designed_against_random.py --first 100 --seeds 10
"""

import argparse
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from designed_against_random_report import write
from excitation_plants import FAMILY, FILL, plant_for, random

from hybrid import identify, validate
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.excitation import Limits, design, observe
from hybrid.plant import Noise
from hybrid.plant.scale import joint_scales
from hybrid.signals import motion_from_recording

TESTS, READ = 8, 40.0  # motions; cut-off of what has no noise, Hz
FITTED = "armature,torque_offset,coulomb,viscous"


def main() -> None:
    """Run all arms and seeds; the table is written after each."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=100, help="seed to begin with")
    parser.add_argument("--cutoff", type=float, help="of all fits, Hz")
    parser.add_argument("--arms", nargs="+", default=["coman_like", "ur10", "scara"])
    parser.add_argument("--out", type=Path, default=Path("out/designed_against_random"))
    options = parser.parse_args()
    warnings.simplefilter("ignore", HybridWarning)
    runs = {}
    for name in options.arms:
        for seed in range(options.first, options.first + options.seeds):
            runs.setdefault(name, []).append(run(name, seed, options.cutoff))
            print(name, seed, runs[name][-1], flush=True)
            write(options.out, options, runs)


def run(name, seed, cutoff):
    """Error by LS, WLS and with friction, CPU s: random, designed, pooled, (3, 4)."""
    rng = np.random.default_rng(seed)
    robot, plant = plant_for(name, rng)
    noise = Noise.typical(robot).torque_covariance
    fitted = effects_from_text(FITTED, robot.joints, joint_scales(robot))
    begin = time.process_time()
    found = design(
        robot, observe(robot.chain, fitted, covariance=noise), FAMILY, seed=rng,
        limits=Limits.of(robot, fill=FILL), starts=2, rate=10.0,
    )  # fmt: skip
    seconds = time.process_time() - begin
    ours = found.trajectories[0].reference(plant.log_rate)
    others = [random(robot, plant.log_rate, rng) for _ in range(1 + TESTS)]
    logs = plant.run([others[0], ours], seed=rng)
    quiet = replace(plant, noise=Noise.none(robot.size)).run(others[1:])
    tests = [motion_from_recording(x, cutoff=READ) for x in quiet]
    rows = []
    for log, cost in zip(logs, (0.0, seconds), strict=True):
        stages = ("rigid", "friction")
        model = identify(robot, [log], stages=stages, cutoff=cutoff).model
        errors = validate(model, tests).rows
        rows.append([*(errors[k].mean for k in (0, 1, -1)), cost])
    model = identify(robot, tests, stages=("rigid",), cutoff=cutoff).model
    errors = validate(model, tests).rows
    return [*rows, [errors[0].mean, errors[1].mean, None, None]]


if __name__ == "__main__":
    main()
