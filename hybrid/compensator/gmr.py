"""Gaussian-mixture regression of the torque that no physical term explains.

A mixture over inputs and residual, ``p(x, y) = Σ π_k N(μ_k, Σ_k)``, conditioned on x::

    E[y|x]   = Σ h_k(x) m_k(x),   m_k(x) = μ_y,k + Σ_yx,k Σ_xx,k⁻¹ (x − μ_x,k)
    Var[y|x] = Σ h_k(x) (S_k + m_k(x)²) − E[y|x]²

Sources: Cohn, Ghahramani and Jordan 1996, doi:10.1613/jair.295; Calinon 2016,
doi:10.1007/s11370-015-0187-9. Outside its data the mixture fades to a prior
``N(0, P)``, where P is the mean square of the training residual: no extrapolation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce
from operator import mul
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError, ModelFileError

_ROWS = 4096  # samples at a time, which stay in the cache
# Inputs are clipped this many standard deviations from the training mean, far outside
# every component, since squares of larger numbers could overflow in single precision.
FARTHEST = 1e6


class Conditional(NamedTuple):
    """The mixture conditioned on standardised inputs z.

    With ``w_k = whitening_k z − centre_k``, component k is at squared Mahalanobis
    distance ``w_kᵀ w_k`` and predicts ``output_mean_k + gain_k w_k``.

    Attributes:
        whitening: Inverse Cholesky factor of Σ_xx, shape (K, d, d), dimensionless.
        centre: Whitened input means, shape (K, d), dimensionless.
        gain: Torque per whitened input, shape (K, d), [N·m].
        output_mean: Output means, shape (K,), [N·m].
        output_variance: Conditional variance S, shape (K,), [(N·m)²].
        log_weight: Log of π_k over the volume of component k, shape (K,).
    """

    whitening: Array
    centre: Array
    gain: Array
    output_mean: Array
    output_variance: Array
    log_weight: Array


@dataclass(frozen=True, eq=False)
class GaussianMixtureRegression:
    """Remaining torque and its variance: d inputs, K components.

    Attributes:
        weights: Component weights with sum 1, shape (K,).
        means: Means of [standardised x, y], shape (K, d+1), [1 and N·m].
        covariances: Covariances of [standardised x, y], shape (K, d+1, d+1).
        input_offset: Training mean of each input, shape (d,), [unit of x].
        input_scale: Training deviation of each input, shape (d,), [unit of x].
        prior_variance: Variance outside the data, shape (1,), [(N·m)²].
        bound: Largest absolute output, shape (1,), [N·m].
        fade: Squared distances (see ``distance``) where the fade starts and where the
            output is zero, shape (2,), dimensionless.

    Raises:
        HybridError: Shapes disagree, a number is not valid, or a covariance is not
            positive definite.
    """

    kind: ClassVar[str] = "gmr"

    weights: Array
    means: Array
    covariances: Array
    input_offset: Array
    input_scale: Array
    prior_variance: Array
    bound: Array
    fade: Array

    def __post_init__(self) -> None:
        for field in fields(self):
            values = np.array(getattr(self, field.name), dtype=np.float64, order="C")
            values.setflags(write=False)
            object.__setattr__(self, field.name, values)
        self._check()

    def _check(self) -> None:
        k, d = self.components, self.inputs
        shapes = (k,), (k, d + 1), (k, d + 1, d + 1), (d,), (d,), (1,), (1,), (2,)
        for (name, values), shape in zip(self.arrays().items(), shapes, strict=True):
            if values.shape != shape or 0 in shape:
                raise HybridError(f"{name} has shape {values.shape}, valid is {shape}")
            if not np.isfinite(values).all():
                raise HybridError(f"{name} has numbers that are not finite")
        if not (self.weights > 0).all() or abs(self.weights.sum() - 1) > 1e-6:
            raise HybridError("weights are not positive with sum 1")
        if not ((self.input_scale > 0).all() and (self.prior_variance > 0).all()):
            raise HybridError("input_scale and prior_variance must be positive")
        if not ((self.bound >= 0).all() and 0 < self.fade[0] < self.fade[1]):
            raise HybridError(
                "bound must not be negative, and fade must increase from > 0"
            )
        try:
            _ = self.conditional
        except np.linalg.LinAlgError as error:
            raise HybridError("a covariance is not positive definite") from error

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return self.input_offset.size

    @property
    def components(self) -> int:
        """Number of components K."""
        return self.weights.size

    def predict(self, x: ArrayLike) -> Array:
        """Expected remaining torque, as :meth:`predict_distribution` gives it."""
        return self.predict_distribution(x)[0]

    def predict_distribution(self, x: ArrayLike) -> tuple[Array, Array]:
        """Expected remaining torque and its variance at inputs, shape (N, d).

        The mean is within ±``bound``, and zero far from the data, shape (N, 1), [N·m];
        the variance has the shape (N, 1), [(N·m)²].

        Raises:
            HybridError: ``x`` has the wrong shape or holds NaN or infinity.
        """
        x = check_matrix("x", x, self.inputs)
        found = np.empty((2, len(x), 1))
        for start in range(0, len(x), _ROWS):
            rows = slice(start, start + _ROWS)
            found[:, rows, 0] = self.at_instant(list(x[rows].T))
        return found[0], found[1]

    def distance(self, x: ArrayLike) -> Array:
        """Soft minimum of the squared Mahalanobis distances to the components, (N,).

        It is ``−2 log Σ_k exp(−d_k²/2)``, which is smooth where another component
        becomes the nearest one, and may be negative where components overlap.
        """
        x = check_matrix("x", x, self.inputs)
        return np.asarray(_soft_minimum(self._parts(list(x.T))[0])[0])

    def arrays(self) -> dict[str, Array]:
        """All arrays by field name; ``from_arrays`` is the inverse."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """The regression from its arrays; its predictions are bitwise equal.

        Raises:
            ModelFileError: An array is missing, unknown, or not valid.
        """
        names = [field.name for field in fields(cls)]
        if set(arrays) != set(names):
            raise ModelFileError(
                f"mixture has arrays {sorted(arrays)}, valid is {sorted(names)}"
            )
        try:
            return cls(**{name: np.asarray(arrays[name], float) for name in names})
        except (HybridError, ValueError, TypeError) as error:
            raise ModelFileError(f"mixture is damaged: {error}") from error

    def at_instant(self, x: Sequence[Any]) -> tuple[Any, Any]:
        """Mean [N·m] and variance [(N·m)²] of the torque, by arithmetic on scalars.

        The inputs are numbers, arrays, or symbols of a tape.
        """
        c, bound, prior = (
            self.conditional,
            self.bound.item(),
            self.prior_variance.item(),
        )
        distance, output = self._parts(x)
        soft, close = _soft_minimum(distance)
        start, end = self.fade.tolist()
        u = np.clip((end - soft) / (end - start), 0.0, 1.0)
        trust = u * u * (3.0 - 2.0 * u)
        distrust = 1.0 - trust
        weight = np.exp(c.log_weight - c.log_weight.max())
        total = _dot(weight, close)
        mean = np.clip(_dot(weight, map(mul, close, output)) / total, -bound, bound)
        noise = c.output_variance.tolist()
        squares = [
            s + (y - mean) * (y - mean) for s, y in zip(noise, output, strict=True)
        ]
        within = _dot(weight, map(mul, close, squares)) / total
        # Law of total variance: the mixture with probability trust, else the prior.
        variance = trust * (within + distrust * mean * mean) + distrust * prior
        return trust * mean, variance

    def _parts(self, x: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """Squared distance to each component, and the torque that it predicts."""
        c = self.conditional
        units = self.input_offset.tolist(), self.input_scale.tolist()
        z = [
            (np.clip(value, mean - FARTHEST * size, mean + FARTHEST * size) - mean)
            / size
            for value, mean, size in zip(x, *units, strict=True)
        ]
        distance, output = [], []
        for k in range(self.components):
            w = [
                _dot(row[: i + 1], z[: i + 1]) - float(c.centre[k, i])
                for i, row in enumerate(c.whitening[k])
            ]
            distance.append(sum(r * r for r in w))
            output.append(float(c.output_mean[k]) + _dot(c.gain[k], w))
        return distance, output

    @cached_property
    def conditional(self) -> Conditional:
        """The mixture conditioned on its inputs.

        Raises:
            numpy.linalg.LinAlgError: A covariance is not positive definite.
        """
        # The Cholesky factor of the joint covariance contains the factor of Σ_xx, the
        # regression Σ_yx L⁻ᵀ and the factor of S, without differences of large numbers.
        d, factor = self.inputs, np.linalg.cholesky(self.covariances)  # (K, d+1, d+1)
        whitening = np.linalg.solve(factor[:, :d, :d], np.eye(d)[None])
        log_volume = np.log(np.diagonal(factor[:, :d, :d], axis1=1, axis2=2)).sum(1)
        return Conditional(
            whitening=whitening,
            centre=np.einsum("kij,kj->ki", whitening, self.means[:, :d]),
            gain=np.asarray(factor[:, d, :d], float),
            output_mean=self.means[:, d],
            output_variance=np.asarray(factor[:, d, d] ** 2, float),
            log_weight=np.log(self.weights) - log_volume,
        )


def _soft_minimum(distance: Sequence[Any]) -> tuple[Any, list[Any]]:
    """``−2 log Σ_k exp(−d_k²/2)``, and its terms relative to the largest one."""
    nearest = reduce(np.minimum, distance)
    close = [np.exp(0.5 * (nearest - d)) for d in distance]
    return nearest - 2.0 * np.log(sum(close)), close


def _dot(factors: Array, values: Iterable[Any]) -> Any:
    """Sum of products of numbers with scalars."""
    return sum(x * y for x, y in zip(factors.tolist(), values, strict=True))


def check_matrix(name: str, values: ArrayLike, columns: int | None = None) -> Array:
    """``values`` as a finite float64 matrix of ``columns`` columns.

    Raises:
        HybridError: The shape is wrong, or a number is not finite.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or columns not in (None, matrix.shape[1]):
        wanted = "any" if columns is None else columns
        raise HybridError(f"{name} has shape {matrix.shape}, valid is (N, {wanted})")
    if not np.isfinite(matrix).all():
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        raise HybridError(
            f"{name} is {matrix[row, column]} at row {row}, column {column}; "
            "valid are finite numbers"
        )
    return matrix
