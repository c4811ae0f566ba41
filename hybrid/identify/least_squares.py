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
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.stats import t as student

from hybrid.errors import IdentificationError
from hybrid.identify.cross_products import CrossProducts
from hybrid.identify.prior import Prior
from hybrid.robot.chain import Array

Estimator = Literal["ls", "wls", "irls"]
ESTIMATORS: tuple[Estimator, ...] = ("ls", "wls", "irls")

_RANK = 1e-13  # smallest eigenvalue of the scaled normal matrix that still counts
_ROUNDING = 1e-12  # of the power of torque: least variance that can be told from zero
_TOLERANCE = 1e-6
_MOST_ITERATIONS = 60
_SURELY = 1e-5  # least diagonal of a factor whose matrix surely has full rank
_MOST_CHANGES = 4  # of what is held at a bound, a number of times each unknown
_FEWEST_BLOCKS = 24
_UNCORRELATED = 0.05
OUTLYING = 3.0  # times the median block misfit


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
        held: Unknowns of which the prior says more than these data.
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
    held: tuple[int, ...] = ()

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
    prior: Prior | None = None,
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
        prior: What is known of the unknowns beforehand.

    Raises:
        IdentificationError: There are fewer samples than unknowns.
    """
    found = settle(products, estimator, bounded=bounded, robust=robust, prior=prior)
    return estimated(products, found, prior=prior)


def estimated(
    products: CrossProducts,
    found: Settled,
    *,
    prior: Prior | None = None,
) -> Estimate:
    """How sure a solution is; arguments are those of :func:`settle`."""
    A, _ = products.normal(found.weight)
    condition, undetermined = _excitation(A)
    covariance, degrees = _covariance(products, found, prior)
    return Estimate(
        theta=found.theta,
        covariance=covariance,
        sigma=residual_covariance(products, found.theta),
        weight=found.weight,
        share=found.share,
        condition=condition,
        iterations=found.iterations,
        converged=found.converged,
        degrees=degrees,
        undetermined=undetermined,
        held=_held(A, prior),
    )


def _held(A: Array, prior: Prior | None) -> tuple[int, ...]:
    """Unknowns whose value would follow data by less than half of any change."""
    if prior is None:
        return ()
    follows = np.diag(_pseudo_inverse(A + prior.precision) @ A)
    return tuple(int(k) for k in np.flatnonzero(follows < 0.5))


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
    """Unknowns and weights of :func:`solve`, without saying how sure they are."""
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


def cross_validate(
    products: CrossProducts,
    estimate: Estimate,
    *,
    bounded: bool = False,
    prior: Prior | None = None,
) -> CrossValidation:
    """Solve without each fold in turn, at the estimate's weight, and score on it.

    Args:
        products: Accumulated data with folds.
        estimate: Solution on all of it.
        bounded: Whether that kept gains at their physical side.
        prior: What was known of the unknowns beforehand.
    """
    theta = without_folds(products, estimate.weight, bounded=bounded, prior=prior)
    theta = theta[np.unique(products.fold)]
    parts = [products.some(products.fold == k) for k in np.unique(products.fold)]
    squares = [x.squares(own) for x, own in zip(parts, theta, strict=True)]
    return CrossValidation(
        theta, np.array(squares), np.array([x.moving for x in parts])
    )


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
    try:
        factor = cho_factor(scaled, lower=True, check_finite=False)
        if np.diag(factor[0]).min() > _SURELY:
            return np.asarray(cho_solve(factor, b / size) / size)
    except np.linalg.LinAlgError:
        pass  # directions without data: settle at zero there
    values, vectors = eigh(scaled)
    keep = values > _RANK * values[-1]
    inside = vectors[:, keep]
    return np.asarray(inside @ ((inside.T @ (b / size)) / values[keep]) / size)


def _bounded_solve(A: Array, b: Array, lower: Array) -> Array:
    """Minimise ½ θᵀAθ − bᵀθ with lower bounds: hold what would fall below, and let go.

    Source: Nocedal and Wright 2006, doi 10.1007/978-0-387-40065-5, section 16.5 (active
    sets).
    """
    held = np.zeros(len(b), dtype=bool)
    theta = np.where(np.isfinite(lower), np.maximum(lower, 0.0), 0.0)
    for _ in range(_MOST_CHANGES * len(b)):
        free = ~held
        aim = theta.copy()
        aim[free] = _pseudo_solve(
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
    limit = OUTLYING * np.median(misfit)
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
    products: CrossProducts, found: Settled, prior: Prior | None
) -> tuple[Array, int]:
    """Delete-a-block jackknife, on blocks long enough to be independent.

    A prior holds unknowns where the data would not: by how much they may be off is
    added, the prior being worth as many samples as the noise lets count for one.

    Source: Efron and Stein 1981, doi 10.1214/aos/1176345462. An unknown at its bound is
    as uncertain as if there were none.
    """
    theta, weight = found.theta, found.weight
    A, b = products.normal(weight)
    held, rest = A, b - A @ theta
    if prior is not None:
        held = held + prior.precision
        rest = rest + prior.pull - prior.precision @ theta
    merged, scores = _independent_blocks(products, _scores(products, theta, weight))
    count = len(scores)
    changes = np.empty((count, len(theta)))
    for k in range(count):
        A_k, _ = merged.normal(weight, merged.blocks[k])
        changes[k] = _pseudo_solve(held - A_k, rest - scores[k])
    spread = changes - changes.mean(axis=0)
    covariance = np.asarray((count - 1) / count * spread.T @ spread)
    if prior is not None:
        inverse = _pseudo_inverse(held)
        noise = np.diag(inverse @ A @ inverse)
        counts = np.diag(covariance) / np.maximum(noise, 1e-300)
        held_by = inverse @ prior.precision @ inverse
        covariance += max(1.0, float(np.median(counts))) * held_by
    return covariance, count - 1


def _scores(products: CrossProducts, theta: Array, weight: Array) -> Array:
    """Gradient of the squares of each block by the unknowns, shape (B, p)."""
    problem = products.problem
    n = len(problem.support)
    C = np.zeros((problem.offsets[-1], n))
    for i, support in enumerate(problem.support):
        start = problem.offsets[i]
        C[start : start + len(support), i] = -theta[support]
        C[start + len(support), i] = 1.0
    left = products.blocks @ (C @ weight)  # (B, P, n): rows times weighted residuals
    found = np.zeros((len(left), problem.size))
    for i, support in enumerate(problem.support):
        start = problem.offsets[i]
        found[:, support] += left[:, start : start + len(support), i]
    return found


def _independent_blocks(
    products: CrossProducts, scores: Array
) -> tuple[CrossProducts, Array]:
    """Merge neighbours until the scores of successive blocks are uncorrelated."""
    factor = 1
    while True:
        label = products.labels(factor)
        starts = np.flatnonzero(np.diff(label, prepend=-1))
        merged = np.add.reduceat(scores, starts)
        enough = len(np.unique(products.labels(2 * factor))) >= _FEWEST_BLOCKS
        recording = products.recording[starts]
        follows = recording[1:] == recording[:-1]
        power = (merged**2).sum(axis=0)
        lagged = (merged[1:][follows] * merged[:-1][follows]).sum(axis=0)
        alike = np.mean(lagged / np.where(power > 0, power, 1.0))
        if alike < _UNCORRELATED or not enough:
            return products.merged(factor), merged
        factor *= 2


def _pseudo_inverse(A: Array) -> Array:
    scaled, size = _scaled(A)
    values, vectors = eigh(scaled)
    keep = values > _RANK * values[-1]
    inside = vectors[:, keep] / size[:, None]
    return np.asarray((inside / values[keep]) @ inside.T)
