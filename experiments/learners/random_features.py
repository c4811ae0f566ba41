"""Bayesian regression on random Fourier features: a Gaussian process in closed form.

Sources: Rahimi and Recht 2007 (NIPS 20, Random features for large-scale kernel
machines); evidence after MacKay 1992, doi 10.1162/neco.1992.4.3.415.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.gmr_fit import check_pair, draw
from learners.envelope import Envelope

_LENGTHS = (0.3, 0.6, 1.2, 2.5)  # training deviations
_NOISES = (0.03, 0.1, 0.3, 1.0)  # share of the outputs' deviation
_ROWS = 4096  # samples at a time


@dataclass(frozen=True, eq=False)
class RandomFeatureRegression:
    """Torque as a sum of P cosines with random directions and Gaussian weights.

    Attributes:
        envelope: Where it is to be believed.
        directions: Angular frequencies, shape (d, P), per training deviation.
        phases: Phases, shape (P,), [rad].
        weights: Mean weight of each feature, shape (P, m), [N·m].
        factor: Square root of the weights' covariance, over that of the noise, (P, P).
        noise: Variance of the noise, shape (m,), [(N·m)²].
    """

    envelope: Envelope
    directions: Array
    phases: Array
    weights: Array
    factor: Array
    noise: Array

    @staticmethod
    def fit(
        x: ArrayLike,
        y: ArrayLike,
        *,
        features: int = 200,
        seed: int | np.random.Generator = 0,
        bound: ArrayLike | None = None,
        max_samples: int = 20_000,
    ) -> RandomFeatureRegression:
        """Weights in closed form; length and noise by the evidence.

        Args:
            x: Inputs, shape (N, d), any unit.
            y: Torque that the physical terms leave, shape (N, m), [N·m].
            features: Number of features P.
            seed: Seed or generator.
            bound: Largest absolute output, [N·m]; the largest of ``y`` by default.
            max_samples: Rows to learn from at most.
        """
        rng = np.random.default_rng(seed)
        x, y = draw(*check_pair(x, y), max_samples, rng)
        envelope = Envelope.around(x, y, bound=bound, rng=rng)
        z, size = envelope.standardised(x), np.sqrt(envelope.prior_variance)
        unit = rng.normal(size=(z.shape[1], features))
        phases = rng.uniform(0.0, 2.0 * np.pi, features)
        best = -np.inf
        for length in _LENGTHS:
            phi = _features(z, unit / length, phases)
            values, vectors = np.linalg.eigh(phi.T @ phi)
            values = np.maximum(values, 0.0)
            seen = vectors.T @ (phi.T @ (y / size))
            for noise in _NOISES:
                score = _evidence(values, seen, y / size, noise)
                if score > best:
                    best, found = score, (length, noise, values, vectors, seen)
        length, noise, values, vectors, seen = found
        shrink = 1.0 / (values + noise**2)
        weights = vectors @ (shrink[:, None] * seen)
        rest = y / size - _features(z, unit / length, phases) @ weights
        return RandomFeatureRegression(
            envelope=envelope,
            directions=unit / length,
            phases=phases,
            weights=weights * size,
            factor=vectors * np.sqrt(shrink),
            noise=(rest**2).mean(axis=0) * size**2,
        )

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return len(self.directions)

    @property
    def outputs(self) -> int:
        """Number of outputs m."""
        return int(self.weights.shape[1])

    def predict(self, x: ArrayLike) -> Array:
        """Mean, shape (N, m), [N·m], as of a mixture."""
        return self.predict_distribution(x)[0]

    def predict_distribution(self, x: ArrayLike) -> tuple[Array, Array]:
        """Mean [N·m] and variance [(N·m)²], shapes (N, m)."""
        z = self.envelope.standardised(x)
        mean = np.empty((len(z), self.outputs))
        variance = np.empty_like(mean)
        for start in range(0, len(z), _ROWS):
            part = slice(start, start + _ROWS)
            phi = _features(z[part], self.directions, self.phases)
            doubt = ((phi @ self.factor) ** 2).sum(axis=1)
            spread = self.noise * (1.0 + doubt[:, None])
            mean[part], variance[part] = self.envelope.blended(
                z[part], phi @ self.weights, spread
            )
        return mean, variance

    def arrays(self) -> dict[str, Array]:
        """All that was learned, by name."""
        names = ("directions", "phases", "weights", "factor", "noise")
        return self.envelope.arrays() | {name: getattr(self, name) for name in names}


def _features(z: Array, directions: Array, phases: Array) -> Array:
    waves: Array = np.cos(z @ directions + phases)
    waves *= np.sqrt(2.0 / len(phases))
    return waves


def _evidence(values: Array, seen: Array, y: Array, noise: float) -> float:
    """Log evidence, plus a constant, from eigenvalues of ΦᵀΦ."""
    n, m = y.shape
    shrink = 1.0 / (values + noise**2)
    fit = (y**2).sum() - (shrink[:, None] * seen**2).sum()
    volume = np.log1p(values / noise**2).sum() + n * np.log(noise**2)
    return float(-0.5 * (fit / noise**2 + m * volume))
