"""A Gaussian mixture conditioned on part of its variables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybrid.arrays import Array

# Inputs are cut off this many deviations from the training mean, where every component
# has long faded: squares of larger numbers could overflow, in single precision first.
FARTHEST = 1e6


class Conditional(NamedTuple):
    """The mixture conditioned on standardised inputs z, as matrices to multiply by.

    With ``w_k = whitening_k z − centre_k``, component k is at squared Mahalanobis
    distance ``w_kᵀ w_k`` and predicts ``output_mean_k + gain_k w_k``.

    Attributes:
        whitening: Inverse Cholesky factor of Σ_xx, shape (K, d, d), dimensionless.
        centre: Whitened input means, shape (K, d), dimensionless.
        gain: Torque per whitened input, shape (K, m, d), [N·m].
        output_mean: Output means, shape (K, m), [N·m].
        output_variance: Variance S left once x is known, shape (K, m), [(N·m)²].
        log_weight: Log of π_k over the volume of component k, shape (K,).
    """

    whitening: Array
    centre: Array
    gain: Array
    output_mean: Array
    output_variance: Array
    log_weight: Array

    @classmethod
    def of(
        cls, weights: Array, means: Array, covariances: Array, d: int
    ) -> Conditional:
        """Condition a joint mixture on its first d variables.

        Args:
            weights: Component weights, shape (K,).
            means: Joint means, inputs first, shape (K, d+m).
            covariances: Joint covariances, shape (K, d+m, d+m).
            d: Number of inputs.

        Returns:
            The matrices that regress the last m variables on the first d.

        Raises:
            numpy.linalg.LinAlgError: A covariance is not positive definite.
        """
        # Cholesky of the joint with x first holds the factor of Σ_xx, the regression
        # Σ_yx L⁻ᵀ and the factor of S: no difference of large numbers.
        factor = np.linalg.cholesky(covariances)  # (K, d+m, d+m)
        whitening = np.linalg.solve(factor[:, :d, :d], np.eye(d)[None])
        log_volume = np.log(np.diagonal(factor[:, :d, :d], axis1=1, axis2=2)).sum(1)
        return cls(
            whitening=whitening,
            centre=np.einsum("kij,kj->ki", whitening, means[:, :d]),
            gain=np.ascontiguousarray(factor[:, d:, :d]),
            output_mean=np.ascontiguousarray(means[:, d:]),
            output_variance=(factor[:, d:, d:] ** 2).sum(2),
            log_weight=np.log(weights) - log_volume,
        )

    def at(self, z: Array) -> tuple[Array, Array, Array]:
        """Every component's answer at given inputs.

        Args:
            z: Standardised inputs, samples last so that sums run along contiguous
                memory, shape (d, N).

        Returns:
            Squared Mahalanobis distance, shape (K, N); responsibility h_k, shape
            (K, N); output m_k, shape (K, m, N), [N·m].
        """
        w = self.whitening @ z - self.centre[..., None]  # (K, d, N)
        distance = np.einsum("kdn,kdn->kn", w, w)
        share = self.log_weight[:, None] - 0.5 * distance
        share = np.exp(share - share.max(axis=0))
        share /= share.sum(axis=0)
        return distance, share, self.output_mean[..., None] + self.gain @ w


def soft_minimum(distance: Array) -> Array:
    """``−2 log Σ_k exp(−d_k²/2)``, the smooth minimum of squared distances.

    Args:
        distance: Squared Mahalanobis distances, shape (K, N).

    Returns:
        Between the minimum and the minimum − 2 log K, shape (N,).
    """
    nearest: Array = distance.min(axis=0)
    excess: Array = np.exp(0.5 * (nearest - distance)).sum(axis=0)
    return nearest - 2.0 * np.log(excess)
