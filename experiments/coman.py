"""The simulated COMAN-like arm that several experiments share.

It prints nothing by itself. Half of a run's motions are for fitting, the other half for
scoring; they are other motions, so nothing is shared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hybrid import Recording, Robot, simulate
from hybrid.arrays import Array
from hybrid.plant import Plant, load_truth

ROOT = Path(__file__).parents[1]
TRUTH = ROOT / "models" / "coman_truth.yaml"


@dataclass(frozen=True)
class Run:
    """Recordings of one seed.

    Attributes:
        robot: The arm as its file says, which is all that a fit is told.
        plant: The arm as it is.
        fitting: Recordings to fit on.
        scoring: Recordings that no fit sees.
        quiet: Torque of the latter without noise, by source, shape (N, n), [N·m].
    """

    robot: Robot
    plant: Plant
    fitting: list[Recording]
    scoring: list[Recording]
    quiet: Mapping[str, Array] = field(default_factory=dict)


def simulate_run(seed: int, *, trajectories: int = 6, duration: float = 10.0) -> Run:
    """Random motions of the arm of ``coman_truth.yaml``, half of them for scoring.

    Args:
        seed: Seed of motions and noise.
        trajectories: Motions of each kind.
        duration: Length of each, [s].
    """
    robot, plant = load_truth(TRUTH)
    every = simulate(plant, trajectories=2 * trajectories, duration=duration, seed=seed)
    return Run(robot, plant, every[:trajectories], every[trajectories:])
