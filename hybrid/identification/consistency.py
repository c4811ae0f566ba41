"""Physically consistent links: bodies that some distribution of mass could make.

A link is physical if and only if its pseudo-inertia, the second moment of its mass in
homogeneous coordinates, is positive semidefinite. That is linear in the ten
parameters, so the physical links nearest to the least-squares solution, in the metric
of the data, are the solution of a semidefinite program.

Source: Wensing, Kim and Slotine 2018, doi 10.1109/LRA.2017.2729659 (pseudo-inertia);
Sousa and Cortesão 2014, doi 10.1177/0278364913514870 (identification as semidefinite
program); Lee, Wensing and Park 2020, doi 10.1109/TRO.2019.2926491 (links measured
against their nominal pseudo-inertia, whatever the frame and the units).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh

from hybrid.arrays import Array
from hybrid.dynamics.cone import nearest_above
from hybrid.dynamics.pseudo_inertia import (
    inertial_per_stacked,
    nominal_bodies,
    stacked,
)
from hybrid.errors import IdentificationError
from hybrid.regression.problem import Problem

# Curvatures are relative to that of the direction which the data see best.
_UNSEEN = 1e-12  # curvature at which there is nothing but rounding
_WEAKEST_PULL = 1e-11  # holds unseen directions at the nominal links
_MOST_LOSS = 4.0  # how often the unavoidable loss may be spent on plausible links
_SMALLEST_SCALE = 1e-5  # curvature of a link, so that the solver's tolerances serve


@dataclass(frozen=True)
class Consistent:
    """Physically consistent links that are nearest to the data.

    Attributes:
        inertial: Link parameters, every link physically consistent, shape (n, 10).
        theta: The unknowns that these links and the gains give, shape (p,).
        loss: Weighted squared residual above that of the unconstrained optimum, as a
            share of the weighted squared torque which that optimum explains.
        converged: False if the solver stopped short of its full accuracy.
    """

    inertial: Array
    theta: Array
    loss: float
    converged: bool


def physically_consistent(
    problem: Problem,
    A: Array,
    b: Array,
    *,
    nominal: Array | None = None,
    margin: float = 1e-4,
) -> Consistent:
    """The physical links and gains that fit the data best.

    Minimises ½ θᵀAθ − bᵀθ, θ being what links and gains give, while every
    pseudo-inertia stays above ``margin`` times the nominal one and every gain above
    ``problem.lower``. Directions that the data do not see stay at the nominal links
    as far as that is physical. The true links are physical and so have the
    unavoidable loss at least: what the data tell less well than that is left to the
    nominal links too, as long as the loss stays within four times the unavoidable.

    Gains that were dropped from the unknowns are 0; the links carry what they would
    (the inertia of the first rotor is in Izz of the first link).

    Args:
        problem: The unknowns.
        A: Normal matrix, shape (p, p).
        b: Right side, shape (p,).
        nominal: Plausible link parameters, shape (n, 10); the chain's own by default.
            A link that is not physical is replaced by a body of its size.
        margin: Smallest pseudo-inertia, as a share of the nominal one, above 0.

    Raises:
        IdentificationError: The data hold nothing, or the solver failed.
    """
    if not (np.isfinite(A).all() and np.isfinite(b).all() and np.trace(A) > 0):
        raise IdentificationError(
            "the normal equations are zero or not finite; there is nothing to fit"
        )
    program = _program(problem, A, b, nominal, margin)
    least = program.solve(_WEAKEST_PULL)
    pull = least.loss
    while pull > _WEAKEST_PULL:
        found = program.solve(pull)
        if found.loss <= _MOST_LOSS * least.loss:
            return found
        pull /= 4
    return least


@dataclass(frozen=True)
class _Program:
    """The fit in coordinates z: links as seen from their nominal selves, then gains.

    Ten coordinates stack the pseudo-inertia of a link in the frame in which the nominal
    one is the identity; each link and each gain is scaled to unit mean curvature, so
    that a light wrist counts like a heavy shoulder.

    Attributes:
        links: Number of links n.
        mapping: Unknowns θ from links and kept gains, shape (p, z).
        frame: Links and kept gains from the coordinates, shape (z, z).
        A: Normal matrix for θ, shape (p, p).
        curvature: Of the data along each direction, the largest being 1, shape (z,).
        directions: Those directions, in columns, shape (z, z).
        optimum: Unconstrained optimum along each direction, 0 where unseen.
        nominal: The nominal links, without gains, along each direction.
        least: Smallest coordinates: of a link as a matrix, of a gain as a number.
    """

    links: int
    mapping: Array
    frame: Array
    A: Array
    curvature: Array
    directions: Array
    optimum: Array
    nominal: Array
    least: Array

    def solve(self, pull: float) -> Consistent:
        """Physical links nearest the data, where curvature above ``pull`` is seen."""
        seen = self.curvature > max(pull, _UNSEEN)
        goal = self.directions @ np.where(seen, self.optimum, self.nominal)
        bend = np.where(seen, self.curvature, pull)
        metric = (self.directions * bend) @ self.directions.T
        z, converged = nearest_above(goal, metric, self.least, self.links)
        standard = self.frame @ z
        theta = self.mapping @ standard
        best = self.mapping @ (self.frame @ (self.directions @ self.optimum))
        change, explained = theta - best, float(best @ self.A @ best)
        loss = float(change @ self.A @ change) / max(explained, 1e-300)
        inertial = standard[: 10 * self.links].reshape(-1, 10)
        return Consistent(inertial, theta, max(loss, 0.0), converged)


def _program(
    problem: Problem, A: Array, b: Array, nominal: Array | None, margin: float
) -> _Program:
    n = problem.chain.size
    bodies = nominal_bodies(
        problem.chain, problem.chain.inertial if nominal is None else nominal
    )
    unknowns = [u for u, column in enumerate(problem.base.kept) if column >= 10 * n]
    gains = [problem.base.kept[u] for u in unknowns]
    mapping = problem.base.mapping[:, [*range(10 * n), *gains]]
    frames = [inertial_per_stacked(root) for root in np.linalg.cholesky(bodies)]
    frame = block_diag(*frames, np.eye(len(gains)))
    size = _sizes(np.diag(frame.T @ mapping.T @ A @ mapping @ frame), n)
    frame /= size
    K = mapping @ frame
    values, directions = eigh(K.T @ A @ K)
    seen = values > _UNSEEN * values[-1]
    along = directions.T @ (K.T @ b)
    ones = np.concatenate([np.tile(stacked(np.eye(4)), n), np.zeros(len(gains))])
    floor = np.concatenate([margin * ones[: 10 * n], problem.lower[unknowns]])
    return _Program(
        links=n,
        mapping=mapping,
        frame=frame,
        A=A,
        curvature=values / values[-1],
        directions=directions,
        optimum=np.where(seen, along / np.where(seen, values, 1.0), 0.0),
        nominal=directions.T @ (ones * size),
        least=floor * size,
    )


def _sizes(curvature: Array, n: int) -> Array:
    """Scale of every coordinate: one for each link, and one for each gain."""
    links = curvature[: 10 * n].reshape(n, 10).mean(axis=1)
    if not links.max() > 0:
        raise IdentificationError("the data say nothing about any link; more is needed")
    gains = curvature[10 * n :] / links.max()
    links = np.maximum(links / links.max(), _SMALLEST_SCALE)
    gains = np.where(gains > 0, gains, 1.0)
    return np.asarray(np.sqrt(np.concatenate([np.repeat(links, 10), gains])))
