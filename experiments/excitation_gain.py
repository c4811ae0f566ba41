"""What a designed motion is worth: standard errors and held-out torque error.

A simulated COMAN-like arm, with friction and ripple that no model here has, moves for
10 s along (a) a random Fourier series, (b) our design for the condition number and (c)
our design for the volume of the confidence ellipsoid: 5 harmonics of 0.1 Hz, 0.8 × all
limits, the torque of the nominal arm included. After the same identification of rigid
body and friction, standard errors of all linear unknowns are compared with (a), and the
torque error on two other random motions that no design knows.

    python experiments/excitation_gain.py --seeds 10
"""

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
from excitation_report import Comparison

from hybrid import identify, validate
from hybrid.effects import effects_from_text
from hybrid.errors import HybridWarning
from hybrid.excitation import Condition, DOptimal, Fourier, Limits, design, observe
from hybrid.plant import load_truth
from hybrid.plant.reference import random_fourier
from hybrid.plant.scale import joint_scales

ROOT = Path(__file__).parents[1]
DESIGNS = ("random", "condition number", "D-optimal")
FAMILY = Fourier(5, 0.1)
FILL = 0.8  # of the limits


def main() -> None:
    """Run all seeds and write the table and the figure."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, default=Path("out/excitation_gain"))
    options = parser.parse_args()
    robot, plant = load_truth(ROOT / "models/coman_truth.yaml")
    unknown = effects_from_text("viscous,coulomb", robot.joints, joint_scales(robot))
    noise = plant.noise.torque_covariance
    observation = observe(robot.chain, unknown, covariance=noise)
    runs = []
    for seed in range(options.seeds):
        runs.append(run(robot, plant, observation, seed))
        write(options.out, robot.joints, runs)


def write(folder, joints, runs):
    """The table and the figure of the seeds so far."""
    rms, seconds, conditions, ratio = (np.array(x) for x in zip(*runs, strict=True))
    lead = "standard errors against those of the random motion, geometric mean: "
    lead += ", ".join(
        f"{name} {relative(x)}"
        for name, x in zip(DESIGNS[1:], ratio[:, 1:].T, strict=True)
    )
    rms = np.concatenate([rms, rms.mean(axis=2, keepdims=True)], axis=2)
    names = (*joints, "mean")
    comparison = Comparison(names, DESIGNS, rms[:, None], seconds, conditions)
    comparison.write(folder, "excitation_gain", ("COMAN-like",), lead)


def relative(x):
    """Median and range; seeds without an unknown that all fits found are left out."""
    known = x[np.isfinite(x)]
    if not len(known):
        return "not known, as no seed has an unknown inside its bounds in all fits"
    text = f"{np.median(known):.2f} ({known.min():.2f}…{known.max():.2f})"
    return text if len(known) == len(x) else f"{text} over {len(known)} seeds"


def run(robot, plant, observation, seed):
    """RMS error (3, n), CPU s, condition, relative standard error; one seed."""
    rng, rate = np.random.default_rng(seed), plant.log_rate
    options = {"duration": FAMILY.duration, "rate": rate, "fill": FILL}
    motions, seconds = [random_fourier(robot, rng=rng, **options)], [0.0]
    for criterion in (Condition(), DOptimal()):
        start = time.process_time()
        found = design(
            robot, observation, FAMILY, rng=rng, criterion=criterion, starts=2,
            limits=Limits.of(robot, fill=FILL), rate=10.0,
        )  # fmt: skip
        seconds.append(time.process_time() - start)
        motions.append(found.trajectories[0].reference(rate))
    others = [random_fourier(robot, rng=rng, **options) for _ in range(2)]
    logs = plant.run([*motions, *others], rng=rng)
    rms, conditions, errors = [], [], []
    for log in logs[:3]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", HybridWarning)
            fit = identify(robot, [log], stages=("rigid", "friction"))
        rms.append(validate(fit.model, logs[3:]).rows[-1].rms)
        conditions.append(fit.condition)
        errors.append(dict(zip(fit.names, fit.covariance.diagonal(), strict=True)))
    # An unknown that a fit put at its bound has no variance there.
    same = [x for x in errors[0] if all(0 < e.get(x, 0) < np.inf for e in errors)]
    if not same:
        return rms, seconds, conditions, np.full(len(errors), np.nan)
    logs = np.log([[x[name] for name in same] for x in errors]).mean(axis=1)
    return rms, seconds, conditions, np.exp((logs - logs[0]) / 2)


if __name__ == "__main__":
    main()
