"""How sure a solution is: intervals, condition, and what the data leave open.

Source: Cameron and Miller 2015, doi 10.3368/jhr.50.2.317 (blocks that are correlated
within).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.special import stdtrit

from hybrid.arrays import Array
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.least_squares import (
    RANK,
    Estimator,
    Settled,
    pseudo_inverse,
    pseudo_solve,
    residual_covariance,
    settle,
    unit_columns,
)
from hybrid.regression.prior import Prior

_MOST_ALIKE = 0.9  # correlation of successive blocks that a log of 100 can show


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
        half = stdtrit(self.degrees, 0.5 + level / 2) * self.std
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
    among: CrossProducts | None = None,
) -> Estimate:
    """How sure a solution is; arguments are those of :func:`settle`.

    Args:
        products: Accumulated data.
        found: The solution.
        prior: What was known of the unknowns beforehand.
        among: The same data with more unknowns behind these, taken to be zero: what was
            chosen on the data is as uncertain as if it had not been.
    """
    A, _ = products.normal(found.weight)
    condition, undetermined = _excitation(A)
    covariance, degrees = _covariance(among or products, found, prior)
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
    """Unknowns that follow a change in the data by less than half of it."""
    if prior is None:
        return ()
    follows = np.diag(pseudo_inverse(A + prior.precision) @ A)
    return tuple(int(k) for k in np.flatnonzero(follows < 0.5))


def _excitation(A: Array) -> tuple[float, tuple[int, ...]]:
    """Condition number of the scaled columns, and unknowns they leave open."""
    values = np.clip(np.linalg.eigvalsh(unit_columns(A)[0]), 0.0, None)
    condition = float(np.sqrt(values[-1] / max(values[0], 1e-300)))
    share = (weak_directions(A, np.sqrt(RANK)) ** 2).sum(axis=1)
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
    values, vectors = eigh(unit_columns(A)[0])
    return np.asarray(vectors[:, values <= weakest**2 * values[-1]])


def _covariance(
    products: CrossProducts, found: Settled, prior: Prior | None
) -> tuple[Array, int]:
    """Delete-a-block jackknife, as much wider as successive blocks change alike.

    A prior holds unknowns where the data would not: by how much they may be off is
    added, the prior being worth as many samples as the noise lets count for one.

    Source: Efron and Stein 1981, doi 10.1214/aos/1176345462. An unknown at its bound is
    as uncertain as if there were none.
    """
    weight, size = found.weight, len(found.theta)
    more = 0, products.problem.size - size
    theta = np.pad(found.theta, more)
    A, b = products.normal(weight)
    held, rest = A, b - A @ theta
    if prior is not None:
        precision = np.pad(prior.precision, more)
        held = held + precision
        rest = rest + np.pad(prior.pull, more) - precision @ theta
    scores = _scores(products, theta, weight)
    count = len(scores)
    changes = np.empty((count, len(theta)))
    for k, own in enumerate(products.normal(weight, products.blocks)[0]):
        changes[k] = pseudo_solve(held - own, rest - scores[k])
    spread = changes - changes.mean(axis=0)
    spread *= np.sqrt(_memory(spread, products.recording))
    covariance = np.asarray((count - 1) / count * spread.T @ spread)
    if prior is not None:
        inverse = pseudo_inverse(held)
        noise = np.diag(inverse @ A @ inverse)
        counts = np.diag(covariance) / np.maximum(noise, 1e-300)
        held_by = inverse @ precision @ inverse
        covariance += max(1.0, float(np.median(counts))) * held_by
    return covariance[:size, :size], count - 1


def _scores(products: CrossProducts, theta: Array, weight: Array) -> Array:
    """Gradient of the squares of each block by the unknowns, shape (B, p)."""
    problem, C = products.problem, products.leaves(theta)
    left = products.blocks @ (C @ weight)  # (B, P, n): rows times weighted residuals
    found = np.zeros((len(left), problem.size))
    for i, support in enumerate(problem.support):
        start = problem.offsets[i]
        found[:, support] += left[:, start : start + len(support), i]
    return found


def _memory(series: Array, recording: NDArray[np.intp]) -> Array:
    """Variance of a sum over that of a sum of independent terms, shape (p,).

    Source: a first-order autoregression, Andrews and Monahan 1992, doi 10.2307/2951574;
    its bias by Kendall 1954, doi 10.1093/biomet/41.3-4.403.

    Args:
        series: What successive blocks change, less its mean, shape (B, p).
        recording: Which recording each block is from, shape (B,).
    """
    follows = recording[1:] == recording[:-1]
    power = np.maximum((series**2).sum(axis=0), 1e-300)
    lagged = (series[1:][follows] * series[:-1][follows]).sum(axis=0) / power
    count = max(int(follows.sum()), 5)
    alike = np.clip((count * lagged + 1) / (count - 4), -_MOST_ALIKE, _MOST_ALIKE)
    return np.asarray((1 + alike) / (1 - alike))
