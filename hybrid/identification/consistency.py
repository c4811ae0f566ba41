"""Physically consistent links: those that some distribution of mass can have.

A link is physically consistent if and only if its pseudo-inertia, the second moment of
its mass in homogeneous coordinates, is positive semidefinite. The pseudo-inertia is
linear in the ten parameters. So the consistent links nearest to the least-squares
solution, in the metric of the data, solve a semidefinite program.

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

# Curvatures are relative to the largest one.
_UNSEEN = 1e-12  # curvature that is rounding error
_WEAKEST_PULL = 1e-11  # curvature that holds unseen directions at the nominal links
_MOST_LOSS = 4.0  # largest loss for nominal links, as a multiple of the least loss
_SMALLEST_SCALE = 1e-5  # smallest curvature of a link that the solver can handle


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
    """The physically consistent links and gains that fit the data best.

    Minimises ½ θᵀAθ − bᵀθ for the unknowns θ of the links and gains, while every
    pseudo-inertia stays above ``margin`` times the nominal one and every gain above
    ``problem.lower``. Directions that the data do not determine stay at the nominal
    links. So do directions that the data determine weakly, as long as the loss stays
    below four times the least loss: the true links are consistent, so they have at
    least that one.

    Gains that were dropped from the unknowns are 0; the links include them (the
    inertia of the first rotor is in Izz of the first link).

    Args:
        problem: The unknowns.
        A: Normal matrix, shape (p, p).
        b: Right side, shape (p,).
        nominal: Nominal link parameters, shape (n, 10); those of the chain by default.
            A link that is not consistent is replaced by a body of its size.
        margin: Smallest pseudo-inertia, as a share of the nominal one, above 0.

    Raises:
        IdentificationError: The normal equations are zero or not finite, or the solver
            failed.
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
    """The semidefinite program in scaled coordinates z of links, then gains.

    Ten coordinates are the stacked pseudo-inertia of a link, in the frame in which the
    nominal one is the identity. Each link and each gain is scaled to a mean curvature
    of 1, so that a light wrist counts as much as a heavy shoulder.

    Attributes:
        links: Number of links n.
        mapping: Maps links and kept gains to the unknowns θ, shape (p, z).
        frame: Maps coordinates to links and kept gains, shape (z, z).
        A: Normal matrix for θ, shape (p, p).
        curvature: Eigenvalues of the data's curvature over the largest, shape (z,).
        directions: Eigenvectors, in columns, shape (z, z).
        optimum: Unconstrained optimum along each eigenvector, 0 where unseen.
        nominal: The nominal links, without gains, along each eigenvector.
        least: Lower bound of the coordinates: of a link as a matrix, of a gain as a
            number.
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
        """The consistent links; directions of curvature below ``pull`` are nominal."""
        seen = self.curvature > max(pull, _UNSEEN)
        target = self.directions @ np.where(seen, self.optimum, self.nominal)
        curvature = np.where(seen, self.curvature, pull)
        metric = (self.directions * curvature) @ self.directions.T
        z, converged = nearest_above(target, metric, self.least, self.links)
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
    """Scale of each coordinate; the ten of a link have the same."""
    links = curvature[: 10 * n].reshape(n, 10).mean(axis=1)
    if not links.max() > 0:
        raise IdentificationError("the data determine no link; more motion is needed")
    gains = curvature[10 * n :] / links.max()
    links = np.maximum(links / links.max(), _SMALLEST_SCALE)
    gains = np.where(gains > 0, gains, 1.0)
    return np.asarray(np.sqrt(np.concatenate([np.repeat(links, 10), gains])))
