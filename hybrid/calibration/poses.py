"""Optimal choice of poses for a calibration."""

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.calibration.calibrate import USUAL, build_setup
from hybrid.calibration.geometry import geometry_from_chain
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.solve import USUAL_NOISE
from hybrid.calibration.steps import follow, start
from hybrid.dynamics.base import base_parameters
from hybrid.errors import CalibrationError
from hybrid.robot import Robot

_ROUNDS = 20  # of exchanges; three or four are usual


def random_poses(
    robot: Robot, count: int, seed: int | np.random.Generator = 0
) -> Array:
    """Uniformly random poses within the joint limits, shape (count, n), [rad or m].

    A joint without limits gets a full turn. Collisions are not checked.

    Raises:
        CalibrationError: A linear joint has no limits.
    """
    free = ~np.isfinite([robot.q_min, robot.q_max]).all(axis=0)
    for j in np.flatnonzero(free & ~robot.chain.revolute):
        joint = robot.joints[j]
        raise CalibrationError(f"{robot.name}: linear joint {joint!r} has no limits")
    low, high = np.where(free, -np.pi, robot.q_min), np.where(free, np.pi, robot.q_max)
    return np.random.default_rng(seed).uniform(low, high, (count, robot.size))


def choose_poses(
    robot: Robot,
    candidates: Array,
    count: int,
    *,
    kind: str = "position",
    free: tuple[str, ...] = USUAL,
) -> Index:
    """Choose the poses with the largest observability index O₁.

    Poses are added one by one, each the best addition, and then exchanged while that
    increases the index: Mitchell 1974, doi 10.1080/00401706.1974.10489175.

    Args:
        robot: Nominal arm.
        candidates: Poses to choose from, shape (C, n), [rad or m].
        count: Number of poses to choose.
        kind: What is measured: ``position`` of a point or ``pose`` of the tool.
        free: Unknowns; see :func:`~hybrid.calibration.calibrate`.

    Returns:
        Rows of the chosen poses in increasing order, shape (count,).

    Raises:
        CalibrationError: There are too few candidates, or poses, for the parameters.
    """
    J = _jacobians(robot, candidates, kind, free)  # (C, c, b)
    least = -(-J.shape[2] // J.shape[1]) + 1
    if not least <= count <= len(candidates):
        raise CalibrationError(
            f"{count} poses; valid are {least}, to identify {J.shape[2]} "
            f"parameters, to {len(candidates)}, the number of candidates"
        )
    # A small prior information, so that the first determinants are not zero.
    prior = 1e-9 * np.einsum("ncb,ncd->bd", J, J)
    chosen = np.full(count, -1)
    for _ in range(1 + _ROUNDS):
        before = sorted(chosen)
        for place in range(count):
            others = np.delete(chosen, place)
            others = others[others >= 0]
            rest = prior + np.einsum("ncb,ncd->bd", J[others], J[others])
            gain = _gain(rest, J)
            gain[others] = -np.inf
            chosen[place] = np.argmax(gain)
        if sorted(chosen) == before:
            break
    return np.sort(chosen)


def _gain(information: Array, J: Array) -> Array:
    """Increase of log det by each candidate, shape (C,)."""
    factor = np.linalg.cholesky(information)
    part = np.linalg.solve(factor, J.reshape(-1, J.shape[2]).T).T.reshape(J.shape)
    inner = np.eye(J.shape[1]) + part @ part.swapaxes(1, 2)
    growth: Array = np.linalg.slogdet(inner)[1]
    return growth


def _jacobians(robot: Robot, q: Array, kind: str, free: tuple[str, ...]) -> Array:
    """Derivatives of the measurements over noise, shape (C, c, b)."""
    if kind not in ("position", "pose"):
        raise CalibrationError(f"no measurement {kind!r}; valid are position and pose")
    flange = follow(start(q), geometry_from_chain(robot.chain).steps, q, {})
    # A general point, since one on the last axis would not show its rotation.
    point = flange.origin + flange.rotation @ np.array([0.05, 0.07, 0.1])
    rotation = flange.rotation if kind == "pose" else None
    data = Measurements(q, point[:, None], rotation)
    setup = build_setup(robot, data, free=free)
    zero = np.zeros(len(setup.labels))
    blocks = setup.model.blocks(data, setup.labels, zero, setup.load)
    J = np.concatenate([b.jacobian for b in blocks], axis=1) / USUAL_NOISE
    units = tuple(setup.model.units[label] for label in setup.labels)
    reduced = base_parameters(J.reshape(-1, len(zero)), setup.labels, units)
    return J[..., list(reduced.kept)]
