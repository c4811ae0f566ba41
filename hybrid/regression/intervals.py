"""Uncertainty of a solution: covariance, intervals, condition, undetermined unknowns.

Source: Cameron and Miller 2015, doi 10.3368/jhr.50.2.317 (cluster-robust inference).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh
from scipy.special import stdtrit

from hybrid.arrays import Array, Index
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.least_squares import (
    RANK,
    WeightedSolution,
    pseudo_inverse,
    pseudo_solve,
    residual_covariance,
    unit_columns,
)
from hybrid.regression.prior import Prior

_MOST_CORRELATION = 0.9  # of successive blocks: the most that 100 blocks can show


@dataclass(frozen=True)
class Estimate(WeightedSolution):
    """A solution of the linear problem with its uncertainty.

    Attributes:
        covariance: Covariance of the unknowns, valid under autocorrelated residuals,
            shape (p, p).
        sigma: Residual covariance across joints, shape (n, n), [N²·m²].
        degrees: Degrees of freedom of the covariance: number of blocks less one.
        undetermined: Indices of unknowns that these data do not determine.
        held: Indices of unknowns that the prior determines more than these data.
    """

    covariance: Array
    sigma: Array
    degrees: int
    undetermined: tuple[int, ...]
    held: tuple[int, ...] = ()

    @property
    def std(self) -> Array:
        """Standard deviation of each unknown, shape (p,)."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper confidence limits, shape (p,) each."""
        half = stdtrit(self.degrees, 0.5 + level / 2) * self.std
        return self.theta - half, self.theta + half


def with_uncertainty(
    products: CrossProducts,
    found: WeightedSolution,
    complete: CrossProducts | None = None,
) -> Estimate:
    """Add the uncertainty to a solution.

    Args:
        products: Cross-products of the data.
        found: The solution.
        complete: Cross-products with more unknowns after these, which the data have
            set to zero. The covariance then includes the uncertainty of that choice.
    """
    A, _ = products.normal(found.weight)
    covariance, degrees = _covariance(complete or products, found)
    return Estimate(
        **vars(found),
        covariance=covariance,
        sigma=residual_covariance(products, found.theta),
        degrees=degrees,
        undetermined=_undetermined(A),
        held=_held(A, found.prior),
    )


def _held(A: Array, prior: Prior | None) -> tuple[int, ...]:
    """Unknowns on which the data have less than half of the influence."""
    if prior is None:
        return ()
    influence = np.diag(pseudo_inverse(A + prior.precision) @ A)
    return tuple(int(k) for k in np.flatnonzero(influence < 0.5))


def condition_number(A: Array) -> float:
    """Condition number of the columns of a normal matrix, scaled to unit length.

    It is infinite where the smallest eigenvalue is rounding error.
    """
    values = np.linalg.eigvalsh(unit_columns(A)[0])
    least = np.finfo(float).eps * len(A) * values[-1]
    return float(np.sqrt(values[-1] / values[0])) if values[0] > least else np.inf


def _undetermined(A: Array) -> tuple[int, ...]:
    share = (weak_directions(A, np.sqrt(RANK)) ** 2).sum(axis=1)
    return tuple(int(k) for k in np.flatnonzero(share > 0.01))


def weak_directions(A: Array, weakest: float) -> Array:
    """Orthonormal directions of small singular values, shape (p, any number).

    These are at most a share ``weakest`` of the largest one. The unknowns are scaled so
    that the regression columns have unit length.
    """
    values, vectors = eigh(unit_columns(A)[0])
    return np.asarray(vectors[:, values <= weakest**2 * values[-1]])


def _covariance(products: CrossProducts, found: WeightedSolution) -> tuple[Array, int]:
    """Covariance by the delete-a-block jackknife, and its degrees of freedom.

    It is inflated for the correlation of successive blocks. A prior adds the
    uncertainty of its own mean, scaled by how many samples of this noise count as one.
    Bounds are ignored.

    Source: Efron and Stein 1981, doi 10.1214/aos/1176345462.
    """
    weight, prior, size = found.weight, found.prior, len(found.theta)
    added = 0, products.problem.size - size
    theta = np.pad(found.theta, added)
    A, b = products.normal(weight)
    hessian, gradient = A, b - A @ theta
    if prior is not None:
        precision = np.pad(prior.precision, added)
        hessian = hessian + precision
        gradient = gradient + np.pad(prior.pull, added) - precision @ theta
    each = zip(*products.normal(weight, products.blocks), strict=True)
    changes = np.array([
        pseudo_solve(hessian - A_k, gradient - (b_k - A_k @ theta)) for A_k, b_k in each
    ])  # fmt: skip
    count = len(changes)
    changes -= changes.mean(axis=0)
    changes *= np.sqrt(_variance_inflation(changes, products.recording))
    covariance = np.asarray((count - 1) / count * changes.T @ changes)
    if prior is not None:
        inverse = pseudo_inverse(hessian)
        white = np.diag(inverse @ A @ inverse)  # variance under independent noise
        counts = np.diag(covariance) / np.maximum(white, 1e-300)
        of_prior = inverse @ precision @ inverse
        covariance += max(1.0, float(np.median(counts))) * of_prior
    return covariance[:size, :size], count - 1


def _variance_inflation(series: Array, recording: Index) -> Array:
    """Variance of the sum of a series over that of independent terms, shape (p,).

    Source: a first-order autoregression, Andrews and Monahan 1992, doi 10.2307/2951574;
    its bias by Kendall 1954, doi 10.1093/biomet/41.3-4.403.
    """
    follows = recording[1:] == recording[:-1]
    power = np.maximum((series**2).sum(axis=0), 1e-300)
    lagged = (series[1:][follows] * series[:-1][follows]).sum(axis=0) / power
    count = max(int(follows.sum()), 5)
    correlation = (count * lagged + 1) / (count - 4)
    correlation = np.clip(correlation, -_MOST_CORRELATION, _MOST_CORRELATION)
    return np.asarray((1 + correlation) / (1 - correlation))
