"""Fourier series of the literature, to stand beside that of the package."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from hybrid.arrays import Array
from hybrid.excitation.families import Fourier, harmonics


@dataclass(frozen=True)
class PlainFourier(Fourier):
    """The series of Swevers et al. 1997 as it is: it does not begin at rest.

    For comparison with designs of the literature; doi 10.1109/70.631234.
    """

    name: ClassVar[str] = "plain_fourier"

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return 2 * self.order + 1

    @cached_property
    def at_rest(self) -> Array:
        """The identity: each basis function is one term."""
        return np.eye(self.size)


@dataclass(frozen=True)
class FourierQuintic(Fourier):
    """A Fourier series and a polynomial of fifth order that brings it to rest.

    In place of the constant term, p(t) = b₀ + … + b₅ t⁵ over each period T cancels the
    speed and the acceleration of the series at 0 and T and moves by nothing, so that
    the position is periodic; b₀ and the 2·order amplitudes are free.
    """

    name: ClassVar[str] = "fourier_quintic"
    least: ClassVar[int] = 1

    @property
    def size(self) -> int:
        """See :class:`~hybrid.excitation.path.Family`."""
        return 2 * self.order + 1

    @cached_property
    def polynomials(self) -> Array:
        """Coefficients b₀ … b₅ of each basis function in t/T, shape (6, m)."""
        # Rows: p(0), p(1) − p(0), p'(0), p'(1), p''(0), p''(1) of the powers.
        powers = np.arange(6.0)
        slope, bend = powers, powers * (powers - 1)
        rows = np.stack(
            [
                powers == 0,
                powers > 0,
                slope * (powers == 1),
                slope,
                bend * (powers == 2),
                bend,
            ]
        ).astype(float)
        end = np.zeros(1)
        wanted = np.zeros((6, self.size))
        wanted[0, 0] = 1.0
        for first, derivative in ((2, 1), (4, 2)):
            series = harmonics(end, self.order, self.fundamental, derivative)
            scaled = series / self.fundamental**derivative
            wanted[first : first + 2, 1:] = -scaled
        return np.asarray(np.linalg.solve(rows, wanted))

    def basis(self, t: Array, derivative: int) -> Array:
        """See :class:`~hybrid.excitation.path.Family`."""
        phase = (t * self.fundamental) % 1.0
        # The end belongs to the last period; it is the same point by continuity.
        powers = np.arange(6)
        factor = np.ones(6)
        for k in range(derivative):
            factor = factor * np.maximum(powers - k, 0)
        left = np.maximum(powers - derivative, 0)
        monomials = factor * phase[:, None] ** left * self.fundamental**derivative
        out = monomials @ self.polynomials
        out[:, 1:] += harmonics(t, self.order, self.fundamental, derivative)
        return np.asarray(out)
