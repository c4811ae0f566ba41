"""Least squares on cross-products: ordinary, weighted, and iteratively reweighted.

Source: Zellner 1962, doi 10.1080/01621459.1962.10480664 (full covariance across
equations).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dpotrs

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.prior import Prior

Estimator = Literal["ls", "wls", "irls"]
ESTIMATORS: tuple[Estimator, ...] = ("ls", "wls", "irls")

RANK = 1e-13  # smallest eigenvalue that is not zero, as a share of the largest
_ROUNDING = 1e-12  # variance that is rounding error, as a share of the torque's power
_NOTHING = 1e-12  # length of a column that is rounding error, over the longest one's
_TOLERANCE = 1e-6  # relative change of the unknowns at which the iteration ends
_MOST_ITERATIONS = 60
# Smallest diagonal of a Cholesky factor that proves full rank. Rounding errors of later
# ones grow by the inverse square of a small one, and must stay below it.
_FULL_RANK = float(np.finfo(float).eps ** 0.25)
_MOST_CHANGES = 4  # of the bounds that hold, for each unknown
_PATIENCE = 3  # steps in which as many unknowns are on the wrong side
OUTLYING = 3.0  # of the median misfit of a block: above it, a block counts less


@dataclass(frozen=True)
class WeightedSolution:
    """A solution, and the weights, bounds and prior that it was found with.

    Attributes:
        theta: Unknowns, shape (p,).
        weight: Weight across joints of the last iteration, shape (n, n).
        share: Weight of each block in the last iteration, from 0 to 1, shape (B,).
        converged: False if the iteration limit was reached first.
        lower: Smallest value of each unknown, shape (p,), or None for no bounds.
        prior: Prior of the unknowns, or None.
    """

    theta: Array
    weight: Array
    share: Array
    converged: bool
    lower: Array | None
    prior: Prior | None


def solve_weighted(
    products: CrossProducts,
    estimator: Estimator,
    *,
    bounded: bool = False,
    robust: bool = False,
    prior: Prior | None = None,
) -> WeightedSolution:
    """Least squares over all joints of an arm, without a covariance.

    ``ls`` gives all joints the same weight. ``wls`` weights each joint by its residual
    variance. ``irls`` weights by the full residual covariance across joints, iterated
    to convergence.

    Args:
        products: Cross-products of the data.
        estimator: One of the three.
        bounded: Keep physically non-negative gains at or above zero.
        robust: Give less weight to blocks whose misfit is far above the median
            (contacts, glitches of the log).
        prior: Prior of the unknowns.

    Raises:
        IdentificationError: There are fewer samples than unknowns.
    """
    n, p = len(products.problem.support), products.problem.size
    if products.samples * n <= p:
        raise IdentificationError(
            f"{products.samples} samples of {n} joints cannot determine {p} unknowns; "
            "longer recordings are needed"
        )
    lower = products.problem.lower if bounded else None

    def solution(weight: Array, share: Array, prior: Prior | None) -> Array:
        A, b = products.shared(share).normal(weight)
        return _optimum(A, b, lower, prior)

    weight: Array = np.eye(n)
    share = np.ones(len(products.counts))
    theta = solution(weight, share, None)
    if prior is not None:  # its weight against the data depends on the noise variance
        sigma = residual_covariance(products, theta, full=False)
        weight = np.eye(n) / np.diag(sigma).mean()
        theta = solution(weight, share, prior)
    converged = estimator != "irls"
    for _ in range({"ls": 0, "wls": 2, "irls": _MOST_ITERATIONS}[estimator]):
        share = _block_weights(products, theta, weight) if robust else share
        full = estimator == "irls"
        sigma = residual_covariance(products, theta, share, full=full)
        weight = np.asarray(np.linalg.inv(sigma), dtype=np.float64)
        before, theta = theta, solution(weight, share, prior)
        change = np.abs(theta - before).max() / (np.abs(theta).max() + 1e-12)
        if change < _TOLERANCE:
            converged = True
            break
    return WeightedSolution(theta, weight, share, converged, lower, prior)


def without_folds(products: CrossProducts, found: WeightedSolution) -> Array:
    """Solutions that each leave one fold out, at the weights of one, shape (F, p)."""
    each = products.shared(found.share).without_folds(found.weight)
    return np.array(
        [_optimum(A, b, found.lower, found.prior) for A, b in zip(*each, strict=True)]
    )


def _optimum(A: Array, b: Array, lower: Array | None, prior: Prior | None) -> Array:
    if prior is not None:
        A, b = A + prior.precision, b + prior.pull
    return pseudo_solve(A, b) if lower is None else _bounded_solve(A, b, lower)


def unit_columns(A: Array) -> tuple[Array, Array]:
    """The normal matrix of columns scaled to unit length, and their lengths, (p,).

    A column that is only rounding error counts as zero, and as infinitely long: scaled
    to unit length, it would be noise that differs from one processor to the next.
    """
    size = np.sqrt(np.clip(np.diag(A), 0.0, None))
    size = np.where(size > _NOTHING * size.max(initial=0.0), size, np.inf)
    return A / size / size[:, None], size


def pseudo_solve(A: Array, b: Array) -> Array:
    """Minimum-norm solution of normal equations in scaled columns, the shape of b.

    There is one right side, shape (p,), or any number of them, (p, any number).
    """
    scaled, size = unit_columns(A)
    factor, fails = dpotrf(scaled, lower=1)
    if not fails and np.diag(factor).min() > _FULL_RANK:
        found, _ = dpotrs(factor, (b.T / size).T, lower=1)
        return np.asarray((found.T / size).T)
    return np.asarray(pseudo_inverse(A) @ b)


def _bounded_solve(A: Array, b: Array, lower: Array) -> Array:
    """Minimise ½ θᵀAθ − bᵀθ with lower bounds, by block principal pivoting.

    All unknowns on the wrong side change sides at once; only the last one does where
    that has not made them fewer for some steps.

    Source: Júdice and Pires 1994, doi 10.1016/0305-0548(94)90106-6.
    """
    held = np.zeros(len(b), dtype=bool)
    least = _TOLERANCE * np.abs(b)
    fewest, patience = len(b) + 1, _PATIENCE
    for _ in range(_MOST_CHANGES * len(b)):
        free, theta = ~held, np.where(held, lower, 0.0)
        if free.any():
            rest = b[free] - A[np.ix_(free, held)] @ theta[held]
            theta[free] = pseudo_solve(A[np.ix_(free, free)], rest)
        wrong = np.where(held, A @ theta - b < -least, theta < lower)
        count = int(wrong.sum())
        if not count:
            break
        patience = _PATIENCE if count < fewest else patience - 1
        fewest = min(fewest, count)
        if patience < 0:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        held ^= wrong
    return np.maximum(theta, lower)


def residual_covariance(
    products: CrossProducts,
    theta: Array,
    share: Array | None = None,
    *,
    full: bool = True,
) -> Array:
    """Covariance of the residuals across joints, shape (n, n), [N²·m²].

    A floor keeps it invertible where a residual is zero. Blocks have weights ``share``,
    shape (B,), or 1; joints are independent if it is not ``full``.

    The likelihood of a full covariance has no maximum in a short log: weights grow
    until one combination of joints is fitted exactly. So its prior is inverse Wishart,
    without correlation, of the fewest degrees of freedom at which it has a mean; a
    block counts as one independent sample.

    Source: Gelman et al. 2013, "Bayesian Data Analysis", section 3.6.
    """
    share = np.ones(len(products.counts)) if share is None else share
    products, blocks = products.shared(share), share.sum()
    n = len(products.problem.support)
    counts = products.counts.sum(axis=0)
    freedom = np.maximum(1.0, counts - products.problem.size / n)
    sigma = products.residual_products(theta) / freedom
    # A difference of cross-products is uncertain by their rounding errors.
    torque = np.diag(products.total)[products.problem.torque_rows]
    power = torque / np.diag(freedom)
    floor = _ROUNDING * np.maximum(power, _ROUNDING * power.max())
    own = np.diag(np.clip(np.diag(sigma), 0.0, None) + floor)
    if not full:
        return own
    # Joints stand at different times, so the pairwise covariance may be indefinite.
    values, vectors = eigh(sigma)
    shared = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return np.asarray((blocks * shared + (n + 1) * own) / (blocks + n + 1))


def _block_weights(products: CrossProducts, theta: Array, weight: Array) -> Array:
    """Weight of each block: 1, or less if its misfit is an outlier."""
    residual = products.residual_products(theta, products.blocks)
    samples = np.trace(products.counts, axis1=1, axis2=2)
    misfit = np.einsum("bij,ij->b", residual, weight) / samples
    limit = OUTLYING * np.median(misfit)
    return np.asarray(np.minimum(1.0, limit / np.maximum(misfit, 1e-300)))


def pseudo_inverse(A: Array) -> Array:
    """Pseudo-inverse of a normal matrix in scaled columns, shape (p, p)."""
    scaled, size = unit_columns(A)
    values, vectors = eigh(scaled)
    keep = values > RANK * values[-1]
    inside = vectors[:, keep] / size[:, None]
    return np.asarray((inside / values[keep]) @ inside.T)
