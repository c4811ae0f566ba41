"""Gaussian-mixture regression: the torque that no physical term explains.

A mixture over inputs and residual, ``p(x, y) = Σ π_k N(μ_k, Σ_k)``, conditioned on x::

    E[y|x]   = Σ h_k(x) m_k(x),   m_k(x) = μ_y,k + Σ_yx,k Σ_xx,k⁻¹ (x − μ_x,k)
    Var[y|x] = Σ h_k(x) (S_k + m_k(x)²) − E[y|x]²

Sources: Cohn, Ghahramani and Jordan 1996, doi:10.1613/jair.295; Calinon 2016,
doi:10.1007/s11370-015-0187-9. Away from its data the mixture hands over to a prior
``N(0, P)``, P the mean square of the training residual: it never extrapolates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce
from operator import mul
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.checks import check_matrix, check_mixture
from hybrid.compensator.conditional import Conditional
from hybrid.errors import HybridError, ModelFileError

_ROWS = 4096  # samples at a time, so that what is worked on stays in the cache
# Inputs are cut off this many deviations from the training mean, where every component
# has long faded: squares of larger numbers could overflow, in single precision first.
FARTHEST = 1e6


@dataclass(frozen=True, eq=False)
class GaussianMixtureRegression:
    """Remaining torque and its variance: d inputs, m outputs, K components.

    Attributes:
        weights: Component weights with sum 1, shape (K,).
        means: Means of [standardised x, y], shape (K, d+m), [1 and N·m].
        covariances: Covariances of [standardised x, y], shape (K, d+m, d+m).
        input_offset: Training mean of each input, shape (d,), [unit of x].
        input_scale: Training deviation of each input, shape (d,), [unit of x].
        prior_variance: Variance where the mixture knows nothing, shape (m,), [(N·m)²].
        bound: Largest absolute output, shape (m,), [N·m].
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
        check_mixture(self)

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return self.input_offset.size

    @property
    def outputs(self) -> int:
        """Number of outputs m."""
        return self.bound.size

    @property
    def components(self) -> int:
        """Number of components K."""
        return self.weights.size

    @classmethod
    def fit(
        cls,
        x: ArrayLike,
        y: ArrayLike,
        *,
        components: int | None = None,
        candidates: Sequence[int] = (1, 2, 4, 8, 16),
        validation: tuple[ArrayLike, ArrayLike] | None = None,
        seed: int | np.random.Generator = 0,
        covariance_floor: float = 1e-4,
        max_samples: int = 20_000,
        bound: ArrayLike | None = None,
    ) -> GaussianMixtureRegression:
        """Learn the mixture by expectation maximisation.

        Args:
            x: Inputs such as joint position and speed, shape (N, d), any unit.
            y: Torque that the physical terms leave, shape (N, m), [N·m].
            components: Number of components K; None chooses among ``candidates``.
            candidates: Numbers of components to try.
            validation: Held-out ``(x, y)``, best whole motions that were not fitted;
                they choose K by predictive likelihood. Without them BIC does, which
                takes samples for independent and so tends to choose too many.
            seed: Seed or generator; equal seeds give equal models.
            covariance_floor: Added to every variance, as a fraction of the variance of
                its channel. Keeps components from collapsing onto a stand-still, at
                whose border the torque would jump.
            max_samples: Rows to learn from at most, drawn without replacement.
            bound: Largest absolute output, shape (m,) or scalar, [N·m], for instance a
                fraction of the rated torque; None takes the largest residual in ``y``.

        Returns:
            The learned regression.

        Raises:
            HybridError: An array has the wrong shape or holds NaN or infinity.
            IdentificationError: Too few samples for the components asked for.
        """
        from hybrid.compensator.gmr_fit import fit_gmr  # scikit-learn is slow to load

        return fit_gmr(
            cls,
            x,
            y,
            candidates=candidates if components is None else (components,),
            validation=validation,
            rng=np.random.default_rng(seed),
            covariance_floor=covariance_floor,
            max_samples=max_samples,
            bound=bound,
        )

    def predict(self, x: ArrayLike) -> Array:
        """Expected remaining torque.

        Args:
            x: Inputs, shape (N, d), [unit of the training inputs].

        Returns:
            Mean, within ±``bound``, zero far from the data, shape (N, m), [N·m].

        Raises:
            HybridError: ``x`` has the wrong shape or holds NaN or infinity.
        """
        return self.predict_distribution(x)[0]

    def predict_distribution(self, x: ArrayLike) -> tuple[Array, Array]:
        """Expected remaining torque and its variance.

        Args:
            x: Inputs, shape (N, d), [unit of the training inputs].

        Returns:
            Mean, shape (N, m), [N·m], and variance, shape (N, m), [(N·m)²]: the
            expected square of what is left after the mean is subtracted.

        Raises:
            HybridError: ``x`` has the wrong shape or holds NaN or infinity.
        """
        x = check_matrix("x", x, self.inputs)
        found = np.empty((2, self.outputs, len(x)))
        for start in range(0, len(x), _ROWS):
            rows = slice(start, start + _ROWS)
            found[:, :, rows] = self.at_instant(list(x[rows].T))
        return found[0].T, found[1].T

    def distance(self, x: ArrayLike) -> Array:
        """Squared Mahalanobis distance to the components' inputs, soft minimum.

        ``−2 log Σ_k exp(−d_k²/2)``: the nearest component decides, and unlike with a
        plain minimum no kink appears where another becomes the nearest.

        Args:
            x: Inputs, shape (N, d), [unit of the training inputs].

        Returns:
            Squared distance, below zero where components overlap, shape (N,).
        """
        x = check_matrix("x", x, self.inputs)
        return np.asarray(_soft_minimum(self._parts(list(x.T))[0])[0])

    def arrays(self) -> dict[str, Array]:
        """Every array by field name, to be saved; ``from_arrays`` is the inverse."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Self:
        """The regression saved by ``arrays``; it predicts the same bits.

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

    def at_instant(self, x: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """Mean [N·m] and variance [(N·m)²] of each output, in arithmetic alone.

        Args:
            x: The inputs: numbers, arrays, or symbols of a tape.
        """
        c, replies = self.conditional, []
        distance, outputs = self._parts(x)
        soft, close = _soft_minimum(distance)
        start, end = self.fade.tolist()
        u = np.clip((end - soft) / (end - start), 0.0, 1.0)
        trust = u * u * (3.0 - 2.0 * u)
        doubt = 1.0 - trust
        weight = np.exp(c.log_weight - c.log_weight.max())
        total = _dot(weight, close)
        for m, reply in enumerate(outputs):
            bound, prior = float(self.bound[m]), float(self.prior_variance[m])
            mean = np.clip(_dot(weight, map(mul, close, reply)) / total, -bound, bound)
            noise = c.output_variance[:, m].tolist()
            off = [
                s + (y - mean) * (y - mean) for s, y in zip(noise, reply, strict=True)
            ]
            spread = _dot(weight, map(mul, close, off)) / total
            # Total variance of: the mixture with probability trust, else N(0, prior).
            variance = trust * (spread + doubt * mean * mean) + doubt * prior
            replies.append((trust * mean, variance))
        means, variances = zip(*replies, strict=True)
        return list(means), list(variances)

    def _parts(self, x: Sequence[Any]) -> tuple[list[Any], list[list[Any]]]:
        """Squared distance to each component, and what each replies at each output."""
        c = self.conditional
        units = self.input_offset.tolist(), self.input_scale.tolist()
        z = [
            (np.clip(value, mean - FARTHEST * size, mean + FARTHEST * size) - mean)
            / size
            for value, mean, size in zip(x, *units, strict=True)
        ]
        distance, outputs = [], [list[Any]() for _ in self.bound]
        for k in range(self.components):
            w = [
                _dot(row[: i + 1], z[: i + 1]) - float(c.centre[k, i])
                for i, row in enumerate(c.whitening[k])
            ]
            distance.append(sum(r * r for r in w))
            for m, output in enumerate(outputs):
                output.append(float(c.output_mean[k, m]) + _dot(c.gain[k, m], w))
        return distance, outputs

    @cached_property
    def conditional(self) -> Conditional:
        """The mixture conditioned on its inputs, computed once."""
        return Conditional.of(self.weights, self.means, self.covariances, self.inputs)


def _soft_minimum(distance: Sequence[Any]) -> tuple[Any, list[Any]]:
    """``−2 log Σ_k exp(−d_k²/2)`` of squared distances, and each term by the largest.

    It lies between the minimum and the minimum − 2 log K.
    """
    nearest = reduce(np.minimum, distance)
    close = [np.exp(0.5 * (nearest - d)) for d in distance]
    return nearest - 2.0 * np.log(sum(close)), close


def _dot(factors: Array, values: Iterable[Any]) -> Any:
    """Sum of products of numbers with scalars."""
    return sum(x * y for x, y in zip(factors.tolist(), values, strict=True))
