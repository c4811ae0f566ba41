"""Recursive least squares in square-root form, with directional forgetting.

Source: Kaminski, Bryson and Schmidt 1971, doi 10.1109/TAC.1971.1099816 (square roots);
Kulhavý and Kárný 1984, doi 10.1016/S1474-6670(17)61051-6, and Cao and Schwartz 2000,
doi 10.1016/S0005-1098(00)00093-5 (directional forgetting); Simon and Chia 2002,
doi 10.1109/7.993234 (projection on bounds).
"""

from collections.abc import Iterator

import numpy as np
from scipy.linalg import blas, lapack

from hybrid.arrays import Array

_ROUNDING = 1e-12  # information, or relative variance, that is rounding error


class SquareRootFilter:
    """Estimate and square root S of its covariance P = S·Sᵀ, which stays PSD.

    An observation brings information σ² in each direction that it measures. There, old
    information 1 is discounted to max(λ, 1 − σ²), so by no more than is gained. The
    covariance thus never grows without excitation (no windup). Under persistent
    excitation it settles at (1 − λ) of the noise, which is the gain of a memory of
    about d/(1 − λ) observations.

    Args:
        mean: Initial estimate, shape (d,).
        root: Square root of its covariance, shape (d, d).
    """

    def __init__(self, mean: Array, root: Array) -> None:
        self.mean = np.array(mean, dtype=float)
        self.root = np.array(root, dtype=float, order="F")  # as BLAS has it, in place

    @property
    def covariance(self) -> Array:
        """Covariance of the estimate, shape (d, d)."""
        return np.asarray(self.root @ self.root.T)

    @property
    def std(self) -> Array:
        """Standard deviation of each unknown, shape (d,)."""
        return np.asarray(np.sqrt(np.einsum("ij,ij->i", self.root, self.root)))

    def update(
        self, projected: Array, error: Array, forgetting: float
    ) -> Iterator[None]:
        """Update with an observation, in two steps.

        An observation of unit noise, with derivative H by the unknowns, is given as
        H·S, shape (m, d). The error, observation less prediction over the noise, has
        the shape (m,); the forgetting factor λ is at most 1.
        """
        power, turn, _ = lapack.dsyevd(projected @ projected.T)
        power = np.maximum(power, _ROUNDING)
        total = np.maximum(forgetting + power, 1.0)
        shrink = (1.0 / np.sqrt(total) - 1.0) / power
        turned, gain = turn.T @ projected, (error @ turn) / total
        yield
        moved = self.root @ turned.T  # (d, m)
        self.mean += moved @ gain
        self.root = blas.dgemm(
            1.0, moved * shrink, turned, 1.0, self.root, overwrite_c=True
        )
        yield

    def add_covariance(self, directions: Array) -> None:
        """Add the covariance D·Dᵀ of ``directions`` D (d, r)."""
        stacked = np.concatenate([self.root, directions], axis=1)
        upper: Array = np.asarray(np.linalg.qr(stacked.T, mode="r"))
        self.root = np.asfortranarray(upper.T)

    def clip(self, lower: Array, upper: Array) -> None:
        """Project an estimate outside its bounds (d,) onto them, in its own metric."""
        (passed,) = np.nonzero((self.mean < lower) | (self.mean > upper))
        if not passed.size:
            return
        inside = np.minimum(np.maximum(self.mean, lower), upper)
        rows = self.root[passed]
        variance = rows @ rows.T
        variance.flat[:: len(passed) + 1] *= 1.0 + _ROUNDING
        _, force, failed = lapack.dposv(variance, inside[passed] - self.mean[passed])
        if not failed:  # else an unknown has no variance and is clipped alone
            self.mean += self.root @ (rows.T @ force)
        np.minimum(np.maximum(self.mean, lower), upper, out=self.mean)
