"""The six-axis arm MOTOMAN MH6 with 24 unknown geometric errors. It prints nothing.

The publication prints no table of nominal lengths; they are those of the arm's data
sheet (base 450, 150; upper arm 614; elbow 155; forearm 640; flange 95 mm), whose reach
150 + 614 + √(155² + 640²) mm is the 1422 mm that the maker states. Base and tool are
known and exact, as in the publication.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.calibration import Measurements
from hybrid.calibration.model import KinematicModel
from hybrid.calibration.steps import Frame, Step

_Q = np.pi / 2
ROWS = (
    {"theta": 0.0, "d": 0.450, "a": 0.150, "alpha": -_Q},
    {"theta": -_Q, "a": 0.614, "alpha": 0.0, "beta": 0.0},
    {"theta": 0.0, "d": 0.0, "a": 0.155, "alpha": -_Q},
    {"theta": 0.0, "d": 0.640, "a": 0.0, "alpha": _Q},
    {"theta": 0.0, "d": 0.0, "a": 0.0, "alpha": -_Q},
    {"theta": 0.0, "d": 0.095, "a": 0.0, "alpha": 0.0},
)
LIMITS = np.deg2rad(
    [[-170, 170], [-90, 155], [-175, 250], [-180, 180], [-45, 225], [-360, 360]]
)
# Rows joints 1 to 6; θ, d (row 2: β), a, α; in 1e-2 rad and mm.
_TRUE = """.1745 2 2 .1745  .1745 .1745 -2 .1745  -.1745 1.5 1.5 -.1745
           .3491 2 2 .3491  .1745 -1.5 -1.5 .1745  -.1745 1 1 -.1745"""
_PUBLISHED = """.1732 1.9422 1.9440 .1750  .1754 .1754 -1.9492 .1747
                -.1736 1.4867 1.5205 -.1738  .3488 1.9434 1.9992 .3491
                .1746 -1.5036 -1.4992 .1746  -.1747 .9879 1.0043 -.1744"""
LABELS = tuple(
    f"{name}_{k + 1}"
    for k in range(6)
    for name in ("theta", "beta" if k == 1 else "d", "a", "alpha")
)
LENGTH = np.array([label[:2] in ("d_", "a_") for label in LABELS])
SHOWN = np.where(LENGTH, 1e3, 1e2)  # mm and 1e-2 rad
TRUE = np.array(_TRUE.split(), dtype=float) / SHOWN
PUBLISHED = np.array(_PUBLISHED.split(), dtype=float) / SHOWN
UPPER = 3.0 * np.abs(TRUE)  # of the search, to either side, as published


def steps_from_dh(rows: Sequence[Mapping[str, float]]) -> tuple[Step, ...]:
    """A chain of revolute joints from a table of the classical (distal) convention.

    A row turns by θ and shifts by d along z, then shifts by a and turns by α along x; a
    row with ``beta`` in place of ``d`` turns by β about y at its end.

    Args:
        rows: For each joint its nominal ``theta``, ``d`` or ``beta``, ``a``, ``alpha``,
            in [rad] and [m]; the unknown parts are named ``theta_1``, ``d_1`` ...
    """
    axes = {"theta": (2, True), "d": (2, False), "a": (0, False), "alpha": (0, True)}
    axes["beta"] = (1, True)
    return tuple(
        Step(*axes[name], row[name], f"{name}_{k + 1}", k if name == "theta" else None)
        for k, row in enumerate(rows)
        for name in axes
        if name in row
    )


MODEL = KinematicModel(steps_from_dh(ROWS), ((),))


def random_poses(count: int, rng: np.random.Generator) -> Array:
    """Poses within the joint limits, shape (count, 6), [rad]."""
    return rng.uniform(*LIMITS.T, (count, 6))


def measure(q: Array, noise: float, outliers: float, seed: int) -> Measurements:
    """The true arm's poses with noise of that size in [m] and [rad].

    Args:
        q: Joint positions, shape (N, 6), [rad].
        noise: Standard deviation of each coordinate.
        outliers: Share of poses that are wrong by 100 times as much.
        seed: Of noise and outliers.
    """
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(seed)
    frame = arms(q, TRUE[None])
    size = noise * np.where(rng.random(len(q)) < outliers, 100.0, 1.0)[:, None]
    turn = Rotation.from_rotvec(size * rng.normal(size=(len(q), 3))).as_matrix()
    position = frame.origin[0] + size * rng.normal(size=(len(q), 3))
    return Measurements(q, position[:, None], turn @ frame.rotation[0])


def arms(q: Array, x: Array) -> Frame:
    """Flange of P arms with errors x, shape (P, 24), in N poses."""
    values = (dict(zip(LABELS, row, strict=True)) for row in x.tolist())
    found = [MODEL.frames(q, each)[0] for each in values]
    rotation, origin = ([getattr(f, k) for f in found] for k in ("rotation", "origin"))
    return Frame(np.array(rotation), np.array(origin))


def pose_errors(x: Array, data: Measurements) -> tuple[Array, Array]:
    """Errors of place [m] and of orientation [rad], shape (P, N) each."""
    assert data.rotation is not None
    frame = arms(data.q, x)
    turn = frame.rotation.swapaxes(-1, -2) @ data.rotation
    skew = turn - turn.swapaxes(-1, -2)
    sine = np.sqrt((skew**2).sum(axis=(-1, -2)) / 8)
    place = np.linalg.norm(frame.origin - data.position[:, 0], axis=-1)
    return place, np.asarray(np.arcsin(np.minimum(sine, 1.0)))
