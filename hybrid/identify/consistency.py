"""Physically consistent links: bodies that some distribution of mass could make.

A link is physical if and only if its pseudo-inertia, the second moment of its mass in
homogeneous coordinates, is positive definite. That is linear in the ten parameters, so
the physical links nearest to a least-squares solution, in the metric of the data, are
found by a semidefinite program.

Source: Wensing, Kim and Slotine 2018, doi 10.1109/LRA.2017.2729659 (pseudo-inertia);
Sousa and Cortesão 2014, doi 10.1177/0278364913514870 (identification as semidefinite
program); Lee, Wensing and Park 2020, doi 10.1109/TRO.2019.2926491 (links measured by
their nominal pseudo-inertia, whatever frame and unit).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, eigh
from scipy.sparse import csc_matrix

from hybrid.errors import IdentificationError
from hybrid.identify.problem import Problem
from hybrid.robot.chain import Array, Chain

# Directions with less than this share of the data's curvature (per link, so that a
# light wrist counts like a heavy shoulder) are not seen: the nominal links decide them.
_UNSEEN = 1e-11
_PULL = 1e-11  # curvature that holds unseen directions at the nominal links
_WATER = 1000.0  # density of a link of unknown mass, [kg/m³]
_THIN = 0.03  # smallest nominal radius of gyration, in link sizes
_SMALLEST_LINK = 0.1  # in lengths of the arm
_TOLERANCE = 1e-12
_UPPER = np.tril_indices(4)[::-1]  # upper triangle column by column, as in Clarabel
VERBOSE=False


@dataclass(frozen=True)
class Consistent:
    """Links that could exist, as near to the data as they can be.

    Attributes:
        inertial: Link parameters, every link physically consistent, shape (n, 10).
        theta: The unknowns that they and the gains give, shape (p,).
        loss: Weighted squared residual above that of the unconstrained optimum, as a
            share of the weighted squared torque which that one explains.
        converged: False if the solver stopped short of its full accuracy.
    """

    inertial: Array
    theta: Array
    loss: float
    converged: bool


def pseudo_inertia(inertial: Array) -> Array:
    """Pseudo-inertia [[Σ, m c], [(m c)ᵀ, m]], with Σ = ½ tr(I)·1 − I.

    Args:
        inertial: Parameters about the link frame in the order of
            :data:`~hybrid.robot.chain.INERTIAL_NAMES`, shape (..., 10).

    Returns:
        Shape (..., 4, 4), in [kg·m²], [kg·m] and [kg].
    """
    inertial = np.asarray(inertial, dtype=float)
    J = np.empty((*inertial.shape[:-1], 4, 4))
    xx, xy, yy, xz, yz, zz = np.moveaxis(inertial[..., 4:], -1, 0)
    half = (xx + yy + zz) / 2
    J[..., 0, 0], J[..., 1, 1], J[..., 2, 2] = half - xx, half - yy, half - zz
    J[..., 0, 1] = J[..., 1, 0] = -xy
    J[..., 0, 2] = J[..., 2, 0] = -xz
    J[..., 1, 2] = J[..., 2, 1] = -yz
    J[..., :3, 3] = J[..., 3, :3] = inertial[..., 1:4]
    J[..., 3, 3] = inertial[..., 0]
    return J


def inertial_from_pseudo(J: Array) -> Array:
    """Inverse of :func:`pseudo_inertia`: shape (..., 4, 4) to (..., 10)."""
    xx, yy, zz = J[..., 0, 0], J[..., 1, 1], J[..., 2, 2]
    about = [yy + zz, -J[..., 0, 1], xx + zz, -J[..., 0, 2], -J[..., 1, 2], xx + yy]
    return np.stack([J[..., 3, 3], *np.moveaxis(J[..., :3, 3], -1, 0), *about], axis=-1)


def is_consistent(inertial: Array, tolerance: float = 1e-12) -> NDArray[np.bool_]:
    """Whether each link could exist: some mass, nowhere negative.

    Args:
        inertial: Link parameters, shape (..., 10).
        tolerance: How far below zero rounding may take an eigenvalue of the
            pseudo-inertia scaled to a unit diagonal.

    Returns:
        True for a physical link, shape (...). Point masses and rods, whose
        distribution has no width in some direction, count as physical.
    """
    J = pseudo_inertia(inertial)
    size = np.sqrt(np.abs(np.diagonal(J, axis1=-2, axis2=-1)))
    size = np.where(size > 0, size, 1.0)
    smallest = np.linalg.eigvalsh(J / size[..., None] / size[..., None, :])[..., 0]
    return np.asarray((smallest >= -tolerance) & (J[..., 3, 3] > 0))


def physically_consistent(
    problem: Problem,
    A: Array,
    b: Array,
    *,
    nominal: Array | None = None,
    margin: float = 1e-4,
) -> Consistent:
    """The physical links and gains that fit the data best.

    Minimises ½ θᵀAθ − bᵀθ, with θ from link parameters and gains, while every
    pseudo-inertia stays above ``margin`` times the nominal one and gains stay above
    ``problem.lower``. What the data do not see is taken from the nominal links as far
    as that is physical. Gains that were dropped from the unknowns stay 0: the links
    carry what they would.

    Args:
        problem: The unknowns.
        A: Normal matrix, shape (p, p).
        b: Right side, shape (p,).
        nominal: Link parameters of the robot file, shape (n, 10); the chain's own by
            default. Links without physical inertia are replaced by bodies of the
            link's size.
        margin: Smallest pseudo-inertia, as a share of the nominal.

    Raises:
        IdentificationError: The semidefinite program was not solved.
    """
    n = problem.chain.size
    body = problem.chain.inertial if nominal is None else nominal
    root = np.linalg.cholesky(_solid(problem.chain, body))
    gains = [c for c in problem.base.kept if c >= 10 * n]
    # Coordinates: each link's pseudo-inertia as seen from its nominal one, then gains.
    frame = block_diag(*map(_link_frame, root), np.eye(len(gains)))
    K = problem.base.mapping[:, [*range(10 * n), *gains]] @ frame
    size = _sizes(K.T @ A @ K, n)
    K /= size
    start = np.concatenate([np.tile(_stacked(np.eye(4)), n), np.zeros(len(gains))])
    lower = problem.lower[[problem.base.kept.index(c) for c in gains]]
    least = np.concatenate([margin * start[: 10 * n], lower]) * size
    best, P = _unconstrained(K.T @ A @ K, K.T @ b, start * size)
    z, converged = _nearest(best, P, least, n)
    links = _inside((z / size)[: 10 * n].reshape(n, 10), margin)
    inertial = inertial_from_pseudo(root @ links @ root.transpose(0, 2, 1))
    values = np.concatenate([inertial.ravel(), np.maximum((z / size)[10 * n :], lower)])
    theta = problem.base.mapping[:, [*range(10 * n), *gains]] @ values
    explained, change = K @ best, theta - K @ best
    loss = float(change @ A @ change / max(explained @ A @ explained, 1e-300))
    return Consistent(inertial, theta, loss, converged)


def _unconstrained(H: Array, right: Array, start: Array) -> tuple[Array, Array]:
    """Least squares where the data see, ``start`` where they do not; and the metric."""
    values, vectors = eigh(H)
    seen = values > _UNSEEN * values[-1]
    along = vectors.T @ start
    along[seen] = (vectors.T @ right)[seen] / values[seen]
    metric = np.where(seen, values, _PULL * values[-1])
    return vectors @ along, (vectors * metric) @ vectors.T


def _nearest(best: Array, P: Array, least: Array, n: int) -> tuple[Array, bool]:
    """Point z nearest to ``best`` in the metric P, with z − least physical.

    Raises:
        IdentificationError: The solver found none.
    """
    import clarabel  # type: ignore[import-not-found, import-untyped]

    bounded = np.isfinite(least)
    cones = [clarabel.PSDTriangleConeT(4)] * n
    cones.append(clarabel.NonnegativeConeT(int(bounded[10 * n :].sum())))
    settings = clarabel.DefaultSettings()
    settings.verbose = VERBOSE
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
    settings.max_iter = 200
    solution = clarabel.DefaultSolver(
        csc_matrix(np.triu(P)),
        np.zeros(len(best)),
        csc_matrix(-np.eye(len(best))[bounded]),
        (best - least)[bounded],
        cones,
        settings,
    ).solve()
    global LAST
    LAST=solution
    status = str(solution.status)
    if status not in ("Solved", "AlmostSolved"):
        raise IdentificationError(
            f"no physically consistent links were found (Clarabel: {status}); "
            "check the scale of the data and the links of the robot file"
        )
    return best + np.array(solution.x), status == "Solved"


def _sizes(H: Array, n: int) -> Array:
    """Weight of each coordinate: of a link as a whole, and of each gain."""
    curvature = np.diag(H).copy()
    curvature[: 10 * n] = np.repeat(curvature[: 10 * n].reshape(n, 10).mean(axis=1), 10)
    curvature = np.maximum(curvature, 1e-12 * curvature.max())
    return np.sqrt(curvature)


def _stacked(J: Array) -> Array:
    """Upper triangle of (..., 4, 4), off-diagonal times √2, shape (..., 10)."""
    weight = np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))
    return J[..., _UPPER[0], _UPPER[1]] * weight


def _unstacked(x: Array) -> Array:
    J = np.zeros((*x.shape[:-1], 4, 4))
    J[..., _UPPER[0], _UPPER[1]] = x / np.where(_UPPER[0] == _UPPER[1], 1.0, np.sqrt(2.0))
    J[..., _UPPER[1], _UPPER[0]] = J[..., _UPPER[0], _UPPER[1]]
    return J


def _link_frame(root: Array) -> Array:
    """Inertial parameters per stacked coordinate, shape (10, 10)."""
    return inertial_from_pseudo(root @ _unstacked(np.eye(10)) @ root.T).T


def _inside(x: Array, margin: float) -> Array:
    values, vectors = np.linalg.eigh(_unstacked(x))
    values = np.maximum(values, margin)
    return (vectors * values[:, None]) @ vectors.transpose(0, 2, 1)


def _solid(chain: Chain, inertial: Array) -> Array:
    """Pseudo-inertias of the nominal links, each made a body with some extent."""
    reach = np.linalg.norm(chain.translation[1:], axis=1)
    reach = np.append(reach, reach[-1:] if reach.size else 0.0)
    total = reach[:-1].sum()
    size = np.maximum(reach, _SMALLEST_LINK * (total if total > 0 else 1.0))
    J = pseudo_inertia(inertial)
    for k in range(chain.size):
        if not J[k, 3, 3] > 0:
            J[k, 3, 3] = _WATER * (size[k] / 4) ** 3
            ahead = chain.translation[k + 1] if k + 1 < chain.size else np.zeros(3)
            J[k, :3, 3] = J[k, 3, :3] = J[k, 3, 3] * ahead / 2
            J[k, :3, :3] = np.outer(J[k,:3,3],J[k,:3,3])/J[k,3,3] + J[k,3,3]*np.eye(3)*(size[k]/4)**2
        mass, moment = J[k, 3, 3], J[k, :3, 3]
        around = np.outer(moment, moment) / mass
        values, vectors = np.linalg.eigh(J[k, :3, :3] - around)
        values = np.maximum(values, mass * (_THIN * size[k]) ** 2)
        J[k, :3, :3] = around + (vectors * values) @ vectors.T
    return J
