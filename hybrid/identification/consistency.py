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

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, eigh

from hybrid.arrays import Array
from hybrid.dynamics.cone import nearest_above
from hybrid.dynamics.pseudo_inertia import inertial_per_stacked, nominal_bodies, stacked
from hybrid.errors import IdentificationError
from hybrid.regression.problem import Problem
from hybrid.robot.chain import Chain

# Curvature, over the largest, that holds unseen directions at the nominal links.
_WEAKEST_PULL = 1e-11
_MARGIN = 1e-4  # smallest pseudo-inertia, as a share of the nominal one
_MOST_LOSS = 4.0  # largest loss for nominal links, as a multiple of the least loss
_SMALLEST_SCALE = 1e-5  # smallest curvature of a link that the solver can handle


@dataclass(frozen=True)
class Consistent:
    """Physically consistent links that are nearest to the data.

    Attributes:
        inertial: Link parameters, every link physically consistent, shape (n, 10).
        beside: Gains that cannot be told from links, by their column.
        theta: The unknowns that these links and the gains give, shape (p,).
        loss: Weighted squared residual above that of the unconstrained optimum, as a
            share of the weighted squared torque which that optimum explains.
        converged: False if the solver stopped short of its full accuracy.
    """

    inertial: Array
    beside: dict[int, float]
    theta: Array
    loss: float
    converged: bool


def physically_consistent(problem: Problem, A: Array, b: Array) -> Consistent:
    """The physically consistent links and gains that fit the data best.

    Minimises ½ θᵀAθ − bᵀθ for the p unknowns θ of the links and gains, while every
    pseudo-inertia stays above a small share of the nominal one, that of the chain, and
    every gain above ``problem.lower``. A nominal link that is not consistent is
    replaced by a body of its size. Directions that the data do not determine stay at
    the nominal links and rotors. So do directions that the data determine weakly, as
    long as the loss stays below four times the least loss: the true links are
    consistent, so they have at least that one.

    A gain that cannot be told from the links, as the inertia of the first rotors, is
    beside them: with a heavy rotor in it, no link would be consistent. Other gains
    that were dropped from the unknowns are 0.

    Raises:
        IdentificationError: The normal equations are zero or not finite, or the solver
            failed.
    """
    if not (np.isfinite(A).all() and np.isfinite(b).all() and np.trace(A) > 0):
        raise IdentificationError(
            "the normal equations are zero or not finite; there is nothing to fit"
        )
    n = problem.chain.size
    unknowns = [u for u, column in enumerate(problem.base.kept) if column >= 10 * n]
    beside = _beside(problem, unknowns)
    gains = [*(problem.base.kept[u] for u in unknowns), *beside]
    mapping = problem.base.mapping[:, [*range(10 * n), *gains]]
    frame, size = _frame(problem.chain, mapping, A)
    ones = np.tile(stacked(np.eye(4)), n)
    nominal = np.append(ones, [_rotor_of_file(problem, column) for column in gains])
    lower = [problem.lower[unknowns], np.zeros(len(beside))]
    floor = np.concatenate([_MARGIN * ones, *lower])
    K = mapping @ frame
    values, directions = eigh(K.T @ A @ K)
    curvature = values / values[-1]
    along, seen = directions.T @ (K.T @ b), curvature > _WEAKEST_PULL
    optimum = np.divide(along, values, out=np.zeros_like(along), where=seen)
    rest = directions.T @ (nominal * size)
    best = mapping @ (frame @ (directions @ optimum))
    explained = max(float(best @ A @ best), 1e-300)

    def solution(pull: float) -> Consistent:
        """The consistent links; directions of curvature below ``pull`` are nominal."""
        used = curvature > pull
        target = directions @ np.where(used, optimum, rest)
        metric = (directions * np.where(used, curvature, pull)) @ directions.T
        z, converged = nearest_above(target, metric, floor * size, n)
        links = frame @ z
        theta = mapping @ links
        change = theta - best
        loss = max(float(change @ A @ change) / explained, 0.0)
        own = dict(zip(beside, links[len(links) - len(beside) :].tolist(), strict=True))
        inertial = links[: 10 * n].reshape(-1, 10)
        return Consistent(inertial, own, theta, loss, converged)

    least = solution(_WEAKEST_PULL)
    pull = least.loss
    while pull > _WEAKEST_PULL:
        found = solution(pull)
        if found.loss <= _MOST_LOSS * least.loss:
            return found
        pull /= 4
    return least


def _beside(problem: Problem, unknowns: list[int]) -> list[int]:
    """Columns of gains of a joint, at least 0, that combine with links only."""
    base, rigid = problem.base, 10 * problem.chain.size
    return [
        column
        for column, (e, g) in enumerate(problem.columns, rigid)
        if column not in base.kept
        and base.mapping[:, column].any()
        and not base.mapping[unknowns, column].any()
        and problem.effects[e].scope == "joint"
        and problem.effects[e].gains[g].lower >= 0
        and not problem.effects[e].changes_signals
    ]


def _rotor_of_file(problem: Problem, column: int) -> float:
    """The gain of a rotor, which may be taken for a link's, in the robot file; or 0."""
    effect = problem.effects[problem.columns[column - 10 * problem.chain.size][0]]
    rotor = effect.id == "armature"
    return float(problem.chain.armature[effect.joints[0]]) if rotor else 0.0


def _frame(chain: Chain, mapping: Array, A: Array) -> tuple[Array, Array]:
    """Map from scaled coordinates to links and gains, and the scale of each coordinate.

    Ten coordinates are the stacked pseudo-inertia of a link, in the frame in which the
    nominal one is the identity; then come the gains. Each link and each gain is scaled
    to a mean curvature of 1, so that a light wrist counts as much as a heavy shoulder.
    """
    bodies = nominal_bodies(chain, chain.inertial)
    frames = [inertial_per_stacked(root) for root in np.linalg.cholesky(bodies)]
    frame = block_diag(*frames, np.eye(mapping.shape[1] - 10 * chain.size))
    curvature = np.diag(frame.T @ mapping.T @ A @ mapping @ frame)
    links, gains = np.split(curvature, [10 * chain.size])
    links = links.reshape(-1, 10).mean(axis=1)
    if not links.max() > 0:
        raise IdentificationError("the data determine no link; more motion is needed")
    gains = gains / links.max()
    links = np.maximum(links / links.max(), _SMALLEST_SCALE)
    gains = np.where(gains > 0, gains, 1.0)
    size = np.sqrt(np.concatenate([np.repeat(links, 10), gains]))
    return frame / size, size
