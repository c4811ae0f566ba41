"""Recursive least squares in square-root form that forgets only what it hears anew.

Source: Kaminski, Bryson and Schmidt 1971, doi 10.1109/TAC.1971.1099816 (square roots);
Kulhavý and Kárný 1984, doi 10.1016/S1474-6670(17)61051-6, and Cao and Schwartz 2000,
doi 10.1016/S0005-1098(00)00093-5 (directional forgetting); Simon and Chia 2002,
doi 10.1109/7.993234 (projection on bounds).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import blas, lapack

from hybrid.arrays import Array

_ROUNDING = 1e-12  # information, or share of a variance, below which there is none


class SquareRootFilter:
    """Estimate and square root S of its covariance P = S·Sᵀ, which never leaves PSD.

    A sample brings information σ² in each of the directions it looks in. In such a
    direction, old information 1 is discounted to max(λ, 1 − σ²): by no more than is
    brought. So the covariance never grows by itself, whatever the excitation (no
    windup), and where excitation persists it settles at (1 − λ) of the noise, which
    keeps the gain of a memory of about d/(1 − λ) observations.

    Args:
        mean: First estimate, shape (d,).
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

    def seen(self, H: Array) -> Array:
        """H·S, shape (m, d): what the unknowns' spread gives to observations.

        Args:
            H: Derivative of the observations by the unknowns, over their noise, (m, d).
        """
        return np.asarray(H @ self.root)

    def update(self, H: Array, error: Array, forgetting: float = 1.0) -> None:
        """Take in one sample of unit noise.

        Args:
            H: Derivative of the observation by the unknowns over its noise, (m, d).
            error: Observation less its prediction over the noise, shape (m,).
            forgetting: λ, at most 1.
        """
        self.weigh(self.seen(H), error, forgetting)
        self.narrow()

    def weigh(self, seen: Array, error: Array, forgetting: float) -> None:
        """First half of :meth:`update`: in which directions the sample tells how much.

        Args:
            seen: See :meth:`seen`.
            error: See :meth:`update`.
            forgetting: λ, at most 1.
        """
        power, turn, _ = lapack.dsyevd(seen @ seen.T)
        power = np.maximum(power, _ROUNDING)
        total = np.maximum(forgetting + power, 1.0)
        shrink = (1.0 / np.sqrt(total) - 1.0) / power
        self._due = turn.T @ seen, shrink, (error @ turn) / total

    def narrow(self) -> None:
        """Second half of :meth:`update`: the mean moves and the root narrows."""
        turned, shrink, gain = self._due
        moved = self.root @ turned.T  # (d, m)
        self.mean += moved @ gain
        self.root = blas.dgemm(
            1.0, moved * shrink, turned, 1.0, self.root, overwrite_c=True
        )

    def widen(self, directions: Array) -> None:
        """Add the covariance D·Dᵀ of ``directions`` D (d, r)."""
        stacked = np.concatenate([self.root, directions], axis=1)
        upper: Array = np.asarray(np.linalg.qr(stacked.T, mode="r"))
        self.root = np.asfortranarray(upper.T)

    def keep_within(self, lower: Array, upper: Array) -> None:
        """Move the estimate to the nearest point, in its own metric, on bounds passed.

        Args:
            lower: Lowest values, shape (d,).
            upper: Highest values, shape (d,).
        """
        (passed,) = np.nonzero((self.mean < lower) | (self.mean > upper))
        if not passed.size:
            return
        inside = np.minimum(np.maximum(self.mean, lower), upper)
        rows = self.root[passed]
        variance = rows @ rows.T
        variance.flat[:: len(passed) + 1] *= 1.0 + _ROUNDING
        _, force, failed = lapack.dposv(variance, inside[passed] - self.mean[passed])
        if not failed:  # else one has no variance at all, and moves alone
            self.mean += self.root @ (rows.T @ force)
        np.minimum(np.maximum(self.mean, lower), upper, out=self.mean)
