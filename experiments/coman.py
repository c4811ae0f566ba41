"""The simulated COMAN-like arm that several experiments share.

It prints nothing by itself. Half of a run's motions are for fitting, the other half for
scoring; they are random motions of their own, so nothing is shared.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hybrid import Fit, Recording, Robot, identify, simulate, validate
from hybrid.errors import HybridWarning
from hybrid.identify import Validation
from hybrid.plant import Plant, load_truth
from hybrid.robot.chain import Array
from hybrid.signals import Sampler

ROOT = Path(__file__).parents[1]
TRUTH = ROOT / "models" / "coman_truth.yaml"
RATE = 500.0  # Hz
STAGES = ("LS", "WLS", "IRLS", "+ friction", "+ ripple", "+ remainder")


@dataclass(frozen=True)
class Run:
    """Recordings of one seed.

    Attributes:
        robot: The arm as its file says, which is all that a fit is told.
        plant: The arm as it is.
        fitting: Recordings to fit on.
        scoring: Recordings that no fit sees.
    """

    robot: Robot
    plant: Plant
    fitting: list[Recording]
    scoring: list[Recording]


def simulate_run(seed: int, *, trajectories: int = 6, duration: float = 10.0) -> Run:
    """Random motions of the arm, as many for fitting as for scoring.

    Args:
        seed: Seed of motions and noise.
        trajectories: Motions of each kind.
        duration: Length of each, [s].
    """
    robot, plant = load_truth(TRUTH)
    every = simulate(plant, trajectories=2 * trajectories, duration=duration, seed=seed)
    return Run(robot, plant, every[:trajectories], every[trajectories:])


def identify_and_validate(run: Run) -> tuple[Fit, Validation]:
    """Fit on one half and score on the other; a stage left out is no news here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)
        fit = identify(run.robot, run.fitting)
    return fit, validate(fit.model, run.scoring)


def noise_floor(plant: Plant, cutoff: float, *, seconds: float = 200.0) -> Array:
    """RMS that the plant's torque noise has after the filter of the identification.

    No model can do better on motions it has not seen.

    Args:
        plant: The arm as it is.
        cutoff: Cut-off of columns and torque, [Hz].
        seconds: Length of the noise that is drawn, [s].

    Returns:
        RMS, shape (n,), [N·m].
    """
    zero = np.zeros((round(seconds * RATE), plant.robot.size))
    assert plant.noise is not None  # a plant without one is given the usual
    rng = np.random.default_rng(0)
    noise = plant.noise.apply({"q": zero, "v": zero, "tau": zero}, rate=RATE, rng=rng)
    return np.asarray(Sampler.for_rate(RATE, cutoff)(noise["tau"]).std(axis=0))
