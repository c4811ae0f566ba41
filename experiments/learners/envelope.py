"""Where a learned remainder may be believed, and how much of it may be used."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.gmr import FARTHEST, check_matrix
from hybrid.compensator.gmr_fit import fit_gmr

LOG_VARIANCE = (-14.0, 6.0)  # range of a network's log variance, standardised
_COMPONENTS = 4


@dataclass(frozen=True, eq=False)
class Envelope:
    """Training range of d inputs as a mixture, and bounds of m outputs.

    Attributes:
        offset: Training mean of each input, shape (d,), [unit of x].
        scale: Training deviation of each input, shape (d,), [unit of x].
        whitening: Inverse Cholesky factor of each component, shape (K, d, d).
        centre: Whitened means, shape (K, d).
        prior_variance: Variance outside, shape (m,), [(N·m)²].
        bound: Largest absolute output, shape (m,), [N·m].
        fade: Squared distances where the fade starts and ends, shape (2,).
    """

    offset: Array
    scale: Array
    whitening: Array
    centre: Array
    prior_variance: Array
    bound: Array
    fade: Array

    @classmethod
    def around(
        cls,
        x: Array,
        y: Array,
        *,
        bound: ArrayLike | None,
        rng: np.random.Generator,
    ) -> Self:
        """The envelope of training data: where a coarse mixture of them is dense.

        Args:
            x: Inputs, shape (N, d), [unit of x].
            y: Remaining torque, shape (N, m), [N·m].
            bound: Largest absolute output, [N·m]; the largest of ``y`` by default.
            rng: Source of the mixture's start.
        """
        mixture = fit_gmr(
            x, y, components=min(_COMPONENTS, len(x) // (x.shape[1] + y.shape[1] + 1)),
            seed=rng, bound=bound, covariance_floor=1e-3,
        )  # fmt: skip
        conditional = mixture.conditional
        return cls(
            offset=mixture.input_offset,
            scale=mixture.input_scale,
            whitening=conditional.whitening,
            centre=conditional.centre,
            prior_variance=mixture.prior_variance,
            bound=mixture.bound,
            fade=mixture.fade,
        )

    def standardised(self, x: ArrayLike) -> Array:
        """Inputs in training deviations, shape (N, d).

        Raises:
            HybridError: ``x`` has the wrong shape or holds NaN or infinity.
        """
        x = check_matrix("x", x, self.offset.size)
        reach = FARTHEST * self.scale
        z: Array = np.clip(x, self.offset - reach, self.offset + reach) - self.offset
        return z / self.scale

    def trust(self, z: Array) -> Array:
        """How far standardised inputs are to be believed, 0 to 1, shape (N,)."""
        w = np.tensordot(z, self.whitening, axes=(1, 2)) - self.centre  # (N, K, d)
        distance = np.einsum("nkd,nkd->nk", w, w)
        nearest = distance.min(axis=1)
        near = np.exp(0.5 * (nearest[:, None] - distance)).sum(axis=1)
        start, end = self.fade
        u = np.clip((end - nearest + 2.0 * np.log(near)) / (end - start), 0.0, 1.0)
        return np.asarray(u * u * (3.0 - 2.0 * u))

    def blended(self, z: Array, mean: Array, variance: Array) -> tuple[Array, Array]:
        """Mean and variance, shape (N, m), bounded and handed over to the prior.

        Args:
            z: Standardised inputs, shape (N, d).
            mean: What was learned, shape (N, m), [N·m].
            variance: Its variance, shape (N, m), [(N·m)²].
        """
        trust = self.trust(z)[:, None]
        doubt, mean = 1.0 - trust, np.clip(mean, -self.bound, self.bound)
        inside = trust * (variance + doubt * mean**2)
        return trust * mean, inside + doubt * self.prior_variance

    def arrays(self) -> dict[str, Array]:
        """Every array, by ``envelope.<name>``."""
        return {f"envelope.{f.name}": getattr(self, f.name) for f in fields(self)}
