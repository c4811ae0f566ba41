"""Gaussian-mixture regression: the torque that no physical term explains.

A mixture over inputs and residual, ``p(x, y) = Σ π_k N(μ_k, Σ_k)``, conditioned on x::

    E[y|x]   = Σ h_k(x) m_k(x),   m_k(x) = μ_y,k + Σ_yx,k Σ_xx,k⁻¹ (x − μ_x,k)
    Var[y|x] = Σ h_k(x) (S_k + m_k(x)²) − E[y|x]²

Sources: Cohn, Ghahramani and Jordan 1996, doi:10.1613/jair.295; Calinon 2016,
doi:10.1007/s11370-015-0187-9. Away from its data the mixture hands over to a prior
``N(0, P)``, P the mean square of the training residual: it never extrapolates.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce
from operator import mul
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.checks import check_matrix, check_mixture
from hybrid.compensator.conditional import FARTHEST as FARTHEST
from hybrid.compensator.conditional import Conditional, soft_minimum
from hybrid.errors import HybridError, ModelFileError

# Size of the largest temporary of one chunk of samples, so that it stays in the cache.
CHUNK_BYTES = 2**20


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
        x = check_matrix("x", x, self.inputs)
        mean = np.empty((len(x), self.outputs))
        for rows in self._chunks(len(x)):
            distance, share, outputs = self._condition(x[rows])
            mean[rows] = (self._trust(distance) * self._mix(share, outputs)).T
        return mean

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
        mean = np.empty((len(x), self.outputs))
        variance = np.empty_like(mean)
        prior = self.prior_variance[:, None]
        noise = self.conditional.output_variance[..., None]
        for rows in self._chunks(len(x)):
            distance, share, outputs = self._condition(x[rows])
            trust = self._trust(distance)  # (n,)
            mixed = self._mix(share, outputs)  # (m, n)
            spread = np.einsum("kn,kmn->mn", share, noise + (outputs - mixed) ** 2)
            mean[rows] = (trust * mixed).T
            # Total variance of: the mixture with probability trust, else N(0, prior).
            doubt = 1.0 - trust
            variance[rows] = (trust * (spread + doubt * mixed**2) + doubt * prior).T
        return mean, variance

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
        distance = np.empty(len(x))
        for rows in self._chunks(len(x)):
            distance[rows] = soft_minimum(self._condition(x[rows])[0])
        return distance

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

    def at_instant(self, x: Sequence[Any]) -> tuple[Any, Any]:
        """Mean [N·m] and variance [(N·m)²] of the first output, of scalars.

        The same in arithmetic alone, as :meth:`Effect.at_instant`: for exports.

        Args:
            x: The inputs: numbers, arrays, or symbols.
        """
        c, offset = self.conditional, self.input_offset.tolist()
        z = [
            np.clip((value - mean) / size, -FARTHEST, FARTHEST)
            for value, mean, size in zip(
                x, offset, self.input_scale.tolist(), strict=True
            )
        ]
        distance, reply = [], []
        for k in range(self.components):
            w = [
                _dot(row[: i + 1], z[: i + 1]) - float(c.centre[k, i])
                for i, row in enumerate(c.whitening[k])
            ]
            distance.append(sum(r * r for r in w))
            reply.append(float(c.output_mean[k, 0]) + _dot(c.gain[k, 0], w))
        nearest = reduce(np.minimum, distance)
        close = [np.exp(0.5 * (nearest - d)) for d in distance]
        weight = np.exp(c.log_weight - c.log_weight.max())
        total, bound = _dot(weight, close), float(self.bound[0])
        mean = np.clip(_dot(weight, map(mul, close, reply)) / total, -bound, bound)
        noise = c.output_variance[:, 0].tolist()
        off = [s + (y - mean) * (y - mean) for s, y in zip(noise, reply, strict=True)]
        spread = _dot(weight, map(mul, close, off)) / total
        trust = _fade(nearest - 2.0 * np.log(sum(close)), *self.fade.tolist())
        doubt, prior = 1.0 - trust, float(self.prior_variance[0])
        return trust * mean, trust * (spread + doubt * mean * mean) + doubt * prior

    @cached_property
    def conditional(self) -> Conditional:
        """The mixture conditioned on its inputs, computed once."""
        return Conditional.of(self.weights, self.means, self.covariances, self.inputs)

    def _chunks(self, samples: int) -> Iterator[slice]:
        width = self.components * max(self.inputs, self.outputs)
        step = max(1, CHUNK_BYTES // (8 * width))
        for start in range(0, samples, step):
            yield slice(start, start + step)

    def _condition(self, x: Array) -> tuple[Array, Array, Array]:
        reach = FARTHEST * self.input_scale
        x = np.clip(x, self.input_offset - reach, self.input_offset + reach)
        return self.conditional.at(((x - self.input_offset) / self.input_scale).T)

    def _mix(self, share: Array, outputs: Array) -> Array:
        limit = self.bound[:, None]
        mixed: Array = np.einsum("kn,kmn->mn", share, outputs)
        return np.clip(mixed, -limit, limit)

    def _trust(self, distance: Array) -> Array:
        return np.asarray(_fade(soft_minimum(distance), *self.fade.tolist()))


def _fade(distance: Any, start: float, end: float) -> Any:
    """One up to a squared distance, zero from another on."""
    u = np.clip((end - distance) / (end - start), 0.0, 1.0)
    return u * u * (3.0 - 2.0 * u)


def _dot(factors: Array, values: Iterable[Any]) -> Any:
    """Sum of products of numbers with scalars."""
    return sum(x * y for x, y in zip(factors.tolist(), values, strict=True))
