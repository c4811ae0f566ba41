"""The most probable links of an explanation that are physical.

Errors of the numbers in a file may be such that a link has no positive mass or inertia.
The evidence of such links counts, but no simulator runs with them.

Source: Wensing, Kim, Slotine 2018, doi 10.1109/LRA.2017.2729659 (pseudo-inertia).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.candidates import with_gains
from hybrid.diagnosis.evidence.evidence import Evidence, Solution
from hybrid.dynamics.cone import nearest_above
from hybrid.dynamics.pseudo_inertia import (
    inertial_per_stacked,
    is_consistent,
    nominal_bodies,
    stacked,
)
from hybrid.effects import Effect
from hybrid.robot.chain import Chain

_MARGIN = 1e-4  # smallest pseudo-inertia of a link, as a share of the file's


def solve_physical(
    evidence: Evidence,
    chain: Chain,
    index: Index,
    effects: Sequence[tuple[Effect, Index]],
) -> Solution:
    """Solve for some columns with links that are physical.

    Args:
        evidence: The cross-products of the columns.
        chain: The links of the file.
        index: The columns. The first ten for each link are errors of its numbers.
        effects: Effects among the others, with their columns.

    Returns:
        The most probable gains with such links; evidence and covariance are those
        without this condition.
    """
    solution = evidence.solve(index)
    n = 10 * len(chain.inertial)
    change = np.eye(len(index))[:n]  # of all links by each gain
    for effect, own in effects:
        for k, unit in zip(own, np.eye(len(own)), strict=True):
            rigid = with_gains(effect, unit).rigid_change(n // 10, chain.gravity)
            if rigid is not None:
                change[:, index == k] = rigid[0].reshape(-1, 1)
    wanted = chain.inertial + (change @ solution.gains).reshape(-1, 10)
    if is_physical(wanted):
        return solution
    # In place of the errors the sums of errors and effects are free, x = T y.
    T = np.eye(len(index))
    T[:n, n:] = -change[:, n:]
    A, b = evidence.normal(index)
    P, b = T.T @ (A + np.diag(evidence.precision[index])) @ T, T.T @ b
    others = cho_factor(P[n:, n:])
    cross = P[n:, :n]
    metric = P[:n, :n] - cross.T @ cho_solve(others, cross)
    links = nearest_physical(wanted, metric, chain) - chain.inertial
    rest = cho_solve(others, b[n:] - cross @ links.ravel())
    return replace(solution, gains=T @ np.concatenate([links.ravel(), rest]))


def is_physical(inertial: Array) -> bool:
    """Whether all links have a positive pseudo-inertia, or no parameters at all."""
    return bool((is_consistent(inertial) | ~inertial.any(axis=1)).all())


def nearest_physical(inertial: Array, metric: Array, chain: Chain) -> Array:
    """The physical links that are nearest to given links, shape (n, 10).

    Args:
        inertial: Parameters of the links, shape (n, 10).
        metric: Positive definite metric of the differences, shape (10n, 10n).
        chain: Links of the file, of which each has a part.
    """
    n = len(inertial)
    bodies = nominal_bodies(chain, chain.inertial)
    frame = block_diag(*map(inertial_per_stacked, np.linalg.cholesky(bodies)))
    # Each link is scaled to unit mean curvature: the solver's tolerances are absolute.
    curvature = np.diag(frame.T @ metric @ frame).reshape(n, 10).mean(axis=1)
    size = np.repeat(np.sqrt(np.maximum(curvature / curvature.max(), 1e-5)), 10)
    frame /= size
    metric = frame.T @ metric @ frame
    metric = np.asarray(metric / np.linalg.eigvalsh(metric)[-1])
    goal = np.asarray(np.linalg.solve(frame, inertial.ravel()), dtype=np.float64)
    least = np.asarray(_MARGIN * np.tile(stacked(np.eye(4)), n) * size)
    z, _ = nearest_above(goal, metric, least, n)
    return np.asarray((frame @ z).reshape(n, 10))
