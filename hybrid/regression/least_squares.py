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
from scipy.linalg import eigh
from scipy.linalg.lapack import dpotrf, dpotrs

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.prior import Prior

Estimator = Literal["ls", "wls", "irls"]
ESTIMATORS: tuple[Estimator, ...] = ("ls", "wls", "irls")

RANK = 1e-13  # smallest eigenvalue of the scaled normal matrix that still counts
_ROUNDING = 1e-12  # of the power of torque: least variance that can be told from zero
_TOLERANCE = 1e-6
_MOST_ITERATIONS = 60
_SURELY = 1e-5  # least diagonal of a factor whose matrix surely has full rank
_MOST_CHANGES = 4  # of what is held at a bound, a number of times each unknown
OUTLYING = 3.0  # times the median block misfit


@dataclass(frozen=True)
class Settled:
    """Unknowns and the weights that belong to them; fields are those of Estimate."""

    theta: Array
    weight: Array
    share: Array
    iterations: int
    converged: bool


def settle(
    products: CrossProducts,
    estimator: Estimator,
    *,
    bounded: bool = False,
    robust: bool = False,
    prior: Prior | None = None,
) -> Settled:
    """Unknowns and weights, without their covariance."""
    n, p = len(products.problem.support), products.problem.size
    if products.samples * n <= p:
        raise IdentificationError(
            f"{products.samples} samples of {n} joints cannot determine {p} unknowns; "
            "longer recordings are needed"
        )
    weight: Array = np.eye(n)
    share = np.ones(len(products.counts))
    theta = _step(products, weight, share, bounded, None)
    if prior is not None:  # whose worth depends on how large the noise is
        variance = np.diag(_sigma(products, theta, share, False)).mean()
        weight = np.eye(n) / variance
        theta = _step(products, weight, share, bounded, prior)
    converged, iterations = estimator == "ls", 0
    limit = {"ls": 0, "wls": 2, "irls": _MOST_ITERATIONS}[estimator]
    while iterations < limit and not converged:
        share = _shares(products, theta, weight) if robust else share
        sigma = _sigma(products, theta, share, estimator == "irls")
        weight = np.asarray(np.linalg.inv(sigma), dtype=np.float64)
        before, theta = theta, _step(products, weight, share, bounded, prior)
        change = np.abs(theta - before).max() / (np.abs(theta).max() + 1e-12)
        converged, iterations = bool(change < _TOLERANCE), iterations + 1
    converged = converged or estimator == "wls"
    return Settled(theta, weight, share, iterations, converged)


def without_folds(
    products: CrossProducts,
    weight: Array,
    *,
    bounded: bool = False,
    prior: Prior | None = None,
    optimum: Callable[[Array, Array], Array] | None = None,
    folds: int = 0,
    share: Array | None = None,
) -> Array:
    """Solutions that each leave one fold out, at a given weight, shape (F, p).

    Args:
        products: Accumulated data with folds.
        weight: Weight across joints, shape (n, n).
        bounded: Keep gains at their physical side.
        prior: What is known of the unknowns beforehand.
        optimum: Unknowns, shape (p,), for a normal matrix and its right side, if they
            are to be found in another way.
        folds: How many there are, where the last may have no sample.
        share: Weight of each block, from 0 to 1, shape (B,).
    """
    if optimum is None:
        optimum = partial(_optimum, lower=products.problem.lower if bounded else None)
    found = []
    if share is None or share.min() == 1.0:
        sums, total = products.folds, products.total
    else:
        sums = products.weighted(share)
        total = sums.sum(axis=0)
    for fold in range(folds or len(sums)):
        own = sums[fold] if fold < len(sums) else 0.0
        A, b = products.normal(weight, total - own)
        if prior is not None:
            A, b = A + prior.precision, b + prior.pull
        found.append(optimum(A, b))
    return np.array(found)


def _step(
    products: CrossProducts,
    weight: Array,
    share: Array,
    bounded: bool,
    prior: Prior | None,
) -> Array:
    sums = np.tensordot(share, products.blocks, axes=1) if share.min() < 1 else None
    A, b = products.normal(weight, sums)
    if prior is not None:
        A, b = A + prior.precision, b + prior.pull
    return _optimum(A, b, products.problem.lower if bounded else None)


def _optimum(A: Array, b: Array, lower: Array | None) -> Array:
    theta = pseudo_solve(A, b)
    if lower is not None and np.any(theta < lower):
        theta = _bounded_solve(A, b, lower)
    return theta


def unit_columns(A: Array) -> tuple[Array, Array]:
    """A normal matrix as of columns of unit length, and their lengths, shape (p,)."""
    size = np.sqrt(np.clip(np.diag(A), 0.0, None))
    size = np.where(size > 0, size, 1.0)
    return A / size / size[:, None], size


def pseudo_solve(A: Array, b: Array) -> Array:
    """Solution of normal equations, zero where the data leave it open, shape (p,)."""
    scaled, size = unit_columns(A)
    factor, fails = dpotrf(scaled, lower=1)
    if not fails and np.diag(factor).min() > _SURELY:
        found, _ = dpotrs(factor, b / size, lower=1)
        return np.asarray(found / size)
    values, vectors = eigh(scaled)
    keep = values > RANK * values[-1]
    inside = vectors[:, keep]
    return np.asarray(inside @ ((inside.T @ (b / size)) / values[keep]) / size)


def _bounded_solve(A: Array, b: Array, lower: Array) -> Array:
    """Minimise ½ θᵀAθ − bᵀθ with lower bounds: hold what would fall below, and let go.

    Source: Nocedal and Wright 2006, doi 10.1007/978-0-387-40065-5, section 16.5 (active
    sets).
    """
    held = np.zeros(len(b), dtype=bool)
    theta = np.maximum(lower, 0.0)
    for _ in range(_MOST_CHANGES * len(b)):
        free = ~held
        aim = theta.copy()
        if free.any():
            aim[free] = pseudo_solve(
                A[np.ix_(free, free)], b[free] - A[np.ix_(free, held)] @ theta[held]
            )
        step = aim - theta
        falls = free & (aim < lower)
        if falls.any():  # go as far as the first bound, and hold it
            share = np.ones_like(theta)
            share[falls] = (lower - theta)[falls] / step[falls]
            first = int(np.argmin(share))
            theta = theta + share[first] * step
            theta[first], held[first] = lower[first], True
            continue
        theta = aim
        push = np.where(held, A @ theta - b, np.inf) / np.sqrt(
            np.maximum(np.diag(A), 1e-300)
        )
        worst = int(np.argmin(push))
        if push[worst] >= -_TOLERANCE * np.abs(b[worst]) / np.sqrt(
            max(A[worst, worst], 1e-300)
        ):
            break
        held[worst] = False
    return theta


def residual_covariance(products: CrossProducts, theta: Array) -> Array:
    """Covariance of what a solution leaves across joints, shape (n, n), [N²·m²]."""
    return _sigma(products, theta, np.ones(len(products.counts)), True)


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
    floor = _ROUNDING * np.maximum(power, _ROUNDING * power.max())
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
    limit = OUTLYING * np.median(misfit)
    return np.asarray(np.minimum(1.0, limit / np.maximum(misfit, 1e-300)))


def pseudo_inverse(A: Array) -> Array:
    """Inverse of a normal matrix on what the data determine, shape (p, p)."""
    scaled, size = unit_columns(A)
    values, vectors = eigh(scaled)
    keep = values > RANK * values[-1]
    inside = vectors[:, keep] / size[:, None]
    return np.asarray((inside / values[keep]) @ inside.T)
