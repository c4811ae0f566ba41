"""A Gaussian mixture conditioned on some of its variables."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hybrid.arrays import Array


class Conditional(NamedTuple):
    """The mixture conditioned on standardised inputs z.

    With ``w_k = whitening_k z − centre_k``, component k is at squared Mahalanobis
    distance ``w_kᵀ w_k`` and predicts ``output_mean_k + gain_k w_k``.

    Attributes:
        whitening: Inverse Cholesky factor of Σ_xx, shape (K, d, d), dimensionless.
        centre: Whitened input means, shape (K, d), dimensionless.
        gain: Torque per whitened input, shape (K, m, d), [N·m].
        output_mean: Output means, shape (K, m), [N·m].
        output_variance: Conditional variance S, shape (K, m), [(N·m)²].
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
        # The Cholesky factor of the joint covariance contains the factor of Σ_xx, the
        # regression Σ_yx L⁻ᵀ and the factor of S, without differences of large numbers.
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
