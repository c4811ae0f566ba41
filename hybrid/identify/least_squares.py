"""Estimators on accumulated cross-products: ordinary, weighted, iteratively reweighted.

Source: Zellner 1962, doi 10.1080/01621459.1962.10480664 (full covariance across
equations); Cameron and Miller 2015, doi 10.3368/jhr.50.2.317 (blocks that are
correlated within).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.optimize import lsq_linear
from scipy.stats import t as student

from hybrid.errors import IdentificationError
from hybrid.identify.cross_products import CrossProducts
from hybrid.robot.chain import Array

Estimator = Literal["ls", "wls", "irls"]
ESTIMATORS: tuple[Estimator, ...] = ("ls", "wls", "irls")

_RANK = 1e-13  # smallest eigenvalue of the scaled normal matrix that still counts
_ROUNDING = 1e-12  # of the power of torque: least variance that can be told from zero
_TOLERANCE = 1e-6
_MOST_ITERATIONS = 60
_FEWEST_BLOCKS = 24
_UNCORRELATED = 0.05
_OUTLYING = 3.0  # times the median block misfit


@dataclass(frozen=True)
class CrossValidation:
    """Solutions that each leave one fold out, and their error on it.

    Attributes:
        theta: Unknowns without each fold, shape (F, p).
        squares: Sum of each joint's squared residuals on the fold, shape (F, n).
        moving: Samples of each joint in the fold, shape (F, n).
    """

    theta: Array
    squares: Array
    moving: Array

    @property
    def rms(self) -> Array:
        """RMS of each joint over all folds, shape (n,), [N·m]."""
        return np.asarray(np.sqrt(self.squares.sum(axis=0) / self.moving.sum(axis=0)))


@dataclass(frozen=True)
class Estimate:
    """A solution of the linear problem and how sure it is.

    Attributes:
        theta: Unknowns, shape (p,).
        covariance: Their covariance, honest under correlated residuals, shape (p, p).
        sigma: Residual covariance across joints, shape (n, n), [N²·m²].
        weight: Weight across joints of the last step, shape (n, n).
        share: Weight of each block in the last step, from 0 to 1, shape (B,).
        condition: Condition number of the whitened, column-scaled columns.
        iterations: Reweightings done.
        converged: False if the iteration limit came first.
        degrees: Degrees of freedom of the covariance (blocks less one).
        undetermined: Unknowns that these data do not determine.
    """

    theta: Array
    covariance: Array
    sigma: Array
    weight: Array
    share: Array
    condition: float
    iterations: int
    converged: bool
    degrees: int
    undetermined: tuple[int, ...]

    @property
    def std(self) -> Array:
        """Standard deviation of each unknown, shape (p,)."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper ends of the confidence intervals, shapes (p,)."""
        half = student.ppf(0.5 + level / 2, self.degrees) * self.std
        return self.theta - half, self.theta + half


def solve(
    products: CrossProducts,
    estimator: Estimator = "irls",
    *,
    bounded: bool = False,
    robust: bool = False,
) -> Estimate:
    """Least squares over the joints of an arm.

    ``ls`` weighs all joints alike, ``wls`` by the variance of each, ``irls`` by the
    full covariance of the residual across joints, iterated until it agrees with itself.

    Args:
        products: Accumulated data.
        estimator: Which of the three.
        bounded: Keep gains that are physically non-negative at or above zero.
        robust: Weigh down blocks whose misfit is far above the median's (contacts,
            log glitches).

    Raises:
        IdentificationError: There are fewer samples than unknowns.
    """
    n, p = len(products.problem.support), products.problem.size
    if products.samples * n <= p:
        raise IdentificationError(
            f"{products.samples} samples of {n} joints cannot determine {p} unknowns; "
            "longer recordings are needed"
        )
    weight: Array = np.eye(n)
    share = np.ones(len(products.counts))
    theta = _step(products, weight, share, bounded)
    converged, iterations = estimator == "ls", 0
    limit = {"ls": 0, "wls": 2, "irls": _MOST_ITERATIONS}[estimator]
    while iterations < limit and not converged:
        share = _shares(products, theta, weight) if robust else share
        sigma = _sigma(products, theta, share, estimator == "irls")
        weight = np.asarray(np.linalg.inv(sigma), dtype=np.float64)
        before, theta = theta, _step(products, weight, share, bounded)
        change = np.abs(theta - before).max() / (np.abs(theta).max() + 1e-12)
        converged, iterations = bool(change < _TOLERANCE), iterations + 1
    converged = converged or estimator == "wls"
    A, _ = products.normal(weight)
    condition, undetermined = _excitation(A)
    covariance, degrees = _covariance(products, theta, weight, bounded)
    return Estimate(
        theta=theta,
        covariance=covariance,
        sigma=_sigma(products, theta, np.ones(len(products.counts)), True),
        weight=weight,
        share=share,
        condition=condition,
        iterations=iterations,
        converged=converged,
        degrees=degrees,
        undetermined=undetermined,
    )


def cross_validate(
    products: CrossProducts,
    estimate: Estimate,
    *,
    bounded: bool = False,
    optimum: Callable[[Array, Array], Array] | None = None,
) -> CrossValidation:
    """Solve without each fold in turn, at the estimate's weight, and score on it.

    Args:
        products: Accumulated data with folds.
        estimate: Solution on all of it.
        bounded: Whether that kept gains at their physical side.
        optimum: Unknowns, shape (p,), for a normal matrix and its right side, if they
            are to be found in another way.
    """
    if optimum is None:
        optimum = partial(_optimum, lower=products.problem.lower if bounded else None)
    folds = np.unique(products.fold)
    A, b = products.normal(estimate.weight)
    theta, squares, moving = [], [], []
    for fold in folds:
        part = products.some(products.fold == fold)
        A_k, b_k = part.normal(estimate.weight)
        found = optimum(A - A_k, b - b_k)
        theta.append(found)
        squares.append(part.squares(found))
        moving.append(part.moving)
    return CrossValidation(np.array(theta), np.array(squares), np.array(moving))


def _step(products: CrossProducts, weight: Array, share: Array, bounded: bool) -> Array:
    sums = np.tensordot(share, products.blocks, axes=1) if share.min() < 1 else None
    A, b = products.normal(weight, sums)
    return _optimum(A, b, products.problem.lower if bounded else None)


def _optimum(A: Array, b: Array, lower: Array | None) -> Array:
    theta = _pseudo_solve(A, b)
    if lower is not None and np.any(theta < lower):
        theta = _bounded_solve(A, b, lower)
    return theta


def _scaled(A: Array) -> tuple[Array, Array]:
    size = np.sqrt(np.clip(np.diag(A), 0.0, None))
    size = np.where(size > 0, size, 1.0)
    return A / size / size[:, None], size


def _pseudo_solve(A: Array, b: Array) -> Array:
    scaled, size = _scaled(A)
    values, vectors = eigh(scaled)
    keep = values > _RANK * values[-1]
    inside = vectors[:, keep]
    return np.asarray(inside @ ((inside.T @ (b / size)) / values[keep]) / size)


def _bounded_solve(A: Array, b: Array, lower: Array) -> Array:
    """Minimise ½ θᵀAθ − bᵀθ with lower bounds, through a square root of A."""
    scaled, size = _scaled(A)
    values, vectors = eigh(scaled)
    keep = values > _RANK * values[-1]
    root = np.sqrt(values[keep])[:, None] * vectors[:, keep].T
    target = (vectors[:, keep].T @ (b / size)) / np.sqrt(values[keep])
    # A trace of the identity makes directions without data settle at zero.
    ridge = np.sqrt(_RANK) * np.eye(len(b))
    found = lsq_linear(
        np.vstack([root, ridge]),
        np.concatenate([target, np.zeros(len(b))]),
        bounds=(lower * size, np.full(len(b), np.inf)),
        method="bvls",
    )
    return np.asarray(found.x / size)


def _sigma(products: CrossProducts, theta: Array, share: Array, full: bool) -> Array:
    """Residual covariance; a floor keeps a joint without residual invertible."""
    sums = np.tensordot(share, products.blocks, axes=1) if share.min() < 1 else None
    n = len(products.problem.support)
    counts = np.tensordot(share, products.counts, axes=1)
    freedom = np.maximum(1.0, counts - products.problem.size / n)
    sigma = products.residual_products(theta, sums) / freedom
    # A difference of cross-products cannot show less than their rounding.
    total = products.total if sums is None else sums
    torque = np.array(products.problem.offsets[1:]) - 1
    power = np.diag(total)[torque] / np.diag(freedom)
    floor = _ROUNDING * np.maximum(power, _ROUNDING * power.max(initial=1e-300))
    if not full:
        return np.asarray(np.diag(np.clip(np.diag(sigma), 0.0, None) + floor))
    # Joints stand at different times: the pairwise covariance may not be positive.
    values, vectors = eigh(sigma)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T + np.diag(floor))


def _shares(products: CrossProducts, theta: Array, weight: Array) -> Array:
    """Weight of each block: one, or less where its misfit is out of line."""
    residual = products.residual_products(theta, products.blocks)
    samples = np.trace(products.counts, axis1=1, axis2=2)
    misfit = np.einsum("bij,ij->b", residual, weight) / samples
    limit = _OUTLYING * np.median(misfit)
    return np.asarray(np.minimum(1.0, limit / np.maximum(misfit, 1e-300)))


def _excitation(A: Array) -> tuple[float, tuple[int, ...]]:
    """Condition number of the scaled columns, and unknowns they leave open."""
    values = np.clip(np.linalg.eigvalsh(_scaled(A)[0]), 0.0, None)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
    share = (weak_directions(A, np.sqrt(_RANK)) ** 2).sum(axis=1)
    return condition, tuple(int(k) for k in np.flatnonzero(share > 0.01))


def weak_directions(A: Array, weakest: float) -> Array:
    """Directions of the unknowns in which the scaled columns hardly move.

    Args:
        A: Normal matrix, shape (p, p).
        weakest: Largest singular value that counts as weak, as a share of the
            largest of all.

    Returns:
        Orthonormal directions in the unknowns scaled to columns of unit length, shape
        (p, any number).
    """
    values, vectors = eigh(_scaled(A)[0])
    return np.asarray(vectors[:, values <= weakest**2 * values[-1]])


def _covariance(
    products: CrossProducts, theta: Array, weight: Array, bounded: bool
) -> tuple[Array, int]:
    """Delete-a-block jackknife, on blocks long enough to be independent.

    Source: Efron and Stein 1981, doi 10.1214/aos/1176345462. Unknowns at their bound
    are held there.
    """
    free = np.flatnonzero(theta > products.problem.lower) if bounded else None
    free = np.arange(len(theta)) if free is None else free
    merged = _independent_blocks(products, theta, weight, free)
    A, b = products.normal(weight)
    rest = b - A @ theta
    count = len(merged.counts)
    changes = np.zeros((count, len(theta)))
    for k in range(count):
        A_k, b_k = merged.normal(weight, merged.blocks[k])
        left = (A - A_k)[np.ix_(free, free)]
        score = (rest - (b_k - A_k @ theta))[free]
        changes[k, free] = _pseudo_solve(left, score)
    spread = changes - changes.mean(axis=0)
    return (count - 1) / count * spread.T @ spread, count - 1


def _independent_blocks(
    products: CrossProducts, theta: Array, weight: Array, free: NDArray[np.intp]
) -> CrossProducts:
    """Merge neighbours until the scores of successive blocks are uncorrelated."""
    factor = 1
    while True:
        merged = products.merged(factor)
        if len(products.merged(2 * factor).counts) < _FEWEST_BLOCKS:
            return merged
        scores = np.array(
            [
                b - A @ theta
                for A, b in (merged.normal(weight, block) for block in merged.blocks)
            ]
        )[:, free]
        follows = merged.recording[1:] == merged.recording[:-1]
        power = (scores**2).sum(axis=0)
        lagged = (scores[1:][follows] * scores[:-1][follows]).sum(axis=0)
        if np.mean(lagged / np.where(power > 0, power, 1.0)) < _UNCORRELATED:
            return merged
        factor *= 2
