"""The prior of the unknowns, from the robot file.

The numbers of the file are uncertain: the standard deviation of a mass is the mass,
that of a first moment is the mass times the size of the link, that of an inertia is the
mass times the size squared; that of a gain is its spread, or its largest bound. If the
motion excites the arm poorly, some unknowns are undetermined; they then stay near the
values of the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Scale
from hybrid.plant.joint_fields import declared_effects
from hybrid.regression.problem import Problem
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

_LEAST_MASS = 0.3  # of the mean mass of the links: a flange may carry a tool
_LEAST_SIZE = 0.1  # of the length of the arm
_UNKNOWN_SIZE = 0.1  # m: size of a link whose length is not in the file
_NO_SPREAD = 1e-9  # variance that counts as zero, as a share of the largest


@dataclass(frozen=True)
class Prior:
    """A normal prior of the unknowns.

    Attributes:
        mean: Expected value, shape (p,).
        precision: Inverse covariance, shape (p, p); zero where nothing is known.
    """

    mean: Array
    precision: Array

    def times(self, factor: float) -> Prior:
        """The prior with ``factor`` times the precision."""
        return Prior(self.mean, factor * self.precision)

    @property
    def pull(self) -> Array:
        """Precision times mean, shape (p,)."""
        return np.asarray(self.precision @ self.mean)


def file_prior(problem: Problem, robot: Robot, scales: Sequence[Scale]) -> Prior | None:
    """The prior from the robot file; None if no link of the file has a mass."""
    chain = problem.chain
    if not (chain.inertial[:, 0] > 0).any():
        return None
    expected, sizes = chain.inertial.ravel().tolist(), link_std(chain).ravel().tolist()
    known = {(e.id, e.joints): e.values for e in declared_effects(robot)}
    for e, g in problem.columns:
        effect = problem.effects[e]
        joint = effect.joints[-1]
        gain = effect.gains[g].scaled(scales[joint])
        declared = known.get((effect.id, effect.joints), {})
        expected.append(declared.get(gain.name, 0.0))
        sizes.append(gain.spread or max(abs(gain.lower), abs(gain.upper)))
    free = {u for u, e, _ in problem.gains if problem.effects[e].changes_signals}
    held = [u for u in range(problem.size) if u not in free]
    mapping = problem.base.mapping[held]
    scaled = mapping * np.array(sizes)
    std = np.linalg.norm(scaled, axis=1)
    scaled /= std[:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    inside = values > _NO_SPREAD * values[-1]
    root = vectors[:, inside] / np.sqrt(values[inside]) / std[:, None]
    mean, precision = np.zeros(problem.size), np.zeros((problem.size, problem.size))
    mean[held] = mapping @ np.array(expected)
    precision[np.ix_(held, held)] = root @ root.T
    return Prior(mean, precision)


def link_std(chain: Chain) -> Array:
    """Standard deviation of each link parameter, shape (n, 10), in its SI unit."""
    mass = np.maximum(chain.inertial[:, 0], 0.0)
    second = np.abs(chain.inertial[:, [4, 6, 9]]).max(axis=1)
    gyration = np.sqrt(second / np.where(mass > 0, mass, 1.0)) * (mass > 0)
    steps = np.linalg.norm(chain.translation, axis=1)
    reach = steps.sum()
    next_joint = np.append(steps[1:], 0.0)
    size = np.maximum(np.maximum(gyration, next_joint / 2), _LEAST_SIZE * reach)
    mass = mass + _LEAST_MASS * mass.mean()
    powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    size = np.where(size > 0, size, _UNKNOWN_SIZE)
    return np.asarray(mass[:, None] * size[:, None] ** powers)
