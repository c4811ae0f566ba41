"""Linear gains under nonlinear shapes: what is to be fitted, and the best gains.

Source: Golub and Pereyra 1973, doi 10.1137/0710036.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from hybrid.errors import IdentificationError
from hybrid.robot.chain import Array

_STEP = 1e-6  # of a shape's range, for differences
_WIDE = 10.0  # ratio of bounds from which a shape is searched by its logarithm
_ALIKE = 1e-13  # eigenvalue below which normalised columns count as dependent


@dataclass(frozen=True)
class SeparableProblem:
    """``target ≈ columns(shapes) @ gains + free @ others``, with bounds.

    Attributes:
        columns: Columns (M, p) for shapes (s,).
        target: What they shall explain, shape (M,).
        lower: Lower bounds of the shapes, shape (s,).
        upper: Upper bounds of the shapes, shape (s,).
        gain_lower: Lower bounds of the gains, shape (p,).
        gain_upper: Upper bounds of the gains, shape (p,).
        free: Columns that depend on no shape, without bounds, shape (M, m).
        block: Number of the block of time each row belongs to, ascending from 0 and
            equal for rows of one instant, shape (M,).

    Raises:
        IdentificationError: Bounds do not fit, or there are too few rows.
    """

    columns: Callable[[Array], Array]
    target: Array
    lower: Array
    upper: Array
    gain_lower: Array
    gain_upper: Array
    free: Array | None = None
    block: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        if not (np.all(self.lower < self.upper) and np.isfinite(self.upper).all()):
            raise IdentificationError(
                "each shape needs finite bounds, lower below upper"
            )
        unknowns = len(self.lower) + len(self.gain_lower)
        unknowns += 0 if self.free is None else self.free.shape[1]
        if len(self.target) <= unknowns:
            raise IdentificationError(
                f"{len(self.target)} samples cannot determine {unknowns} unknowns"
            )

    @cached_property
    def wide(self) -> NDArray[np.bool_]:
        """Shapes that are searched by their logarithm, shape (s,)."""
        low = np.maximum(self.lower, 1e-300)
        return np.asarray((self.lower > 0) & (self.upper / low >= _WIDE))

    def shapes(self, u: Array) -> Array:
        """Shapes from coordinates of 0 to 1 between their bounds, shape (s,)."""
        low, high = self.lower, self.upper
        ratio = np.where(self.wide, high / np.where(self.wide, low, 1.0), 1.0)
        found = np.where(self.wide, low * ratio**u, low + u * (high - low))
        return np.clip(found, low, high)

    def coordinates(self, shapes: Array) -> Array:
        """Coordinates of shapes, the inverse of :meth:`shapes`; shape (s,)."""
        low, high = self.lower, self.upper
        x = np.clip(shapes, low, high)
        safe = np.where(self.wide, low, 1.0)
        log = np.log(np.where(self.wide, x, 1.0) / safe)
        log /= np.log(np.where(self.wide, high / safe, np.e))
        return np.where(self.wide, log, (x - low) / (high - low))

    def per_coordinate(self, shapes: Array) -> Array:
        """Change of each shape per change of its coordinate, shape (s,)."""
        safe = np.where(self.wide, self.lower, 1.0)
        log_width = np.log(np.where(self.wide, self.upper / safe, 1.0))
        width = self.upper - self.lower
        return np.where(self.wide, shapes * log_width, width)

    @cached_property
    def _basis(self) -> Array:
        """Orthonormal columns that span ``free``, shape (M, ≤ m)."""
        assert self.free is not None
        size = np.linalg.norm(self.free, axis=0)
        Q, R = np.linalg.qr(self.free / np.where(size > 0, size, 1.0))
        turn, spread, _ = np.linalg.svd(R)
        return np.asarray(Q @ turn[:, : len(spread)][:, spread > 1e-10 * spread[0]])

    def without_free(self, x: Array) -> Array:
        """What ``free`` cannot explain of some columns."""
        if self.free is None:
            return x
        return np.asarray(x - self._basis @ (self._basis.T @ x))

    @cached_property
    def rest(self) -> Array:
        """What ``free`` cannot explain of the target, shape (M,)."""
        return self.without_free(self.target)

    def gains(self, shapes: Array) -> tuple[Array, Array, Array]:
        """Best gains for some shapes.

        Returns:
            Gains, shape (p,); the columns less what ``free`` explains of them, shape
            (M, p); what is left of the target, shape (M,).
        """
        B = self.without_free(self.columns(shapes))
        root, inverse = roots(B)
        g = inverse.T @ (inverse @ (B.T @ self.rest))
        low, high = self.gain_lower, self.gain_upper
        left = self.rest - B @ g
        step = inverse.T @ (inverse @ (B.T @ left))  # what rounding has cost
        g, left = g + step, left - B @ step
        if np.any(g < low) or np.any(g > high):
            size = np.linalg.norm(root, axis=0)
            size = np.where(size > 0, size, 1.0)
            z = inverse @ (B.T @ self.rest)
            bounds = (low * size, high * size)
            g = lsq_linear(root / size, z, bounds=bounds, method="bvls").x / size
            left = self.rest - B @ g
        return g, B, left

    def inside(self, gains: Array) -> NDArray[np.bool_]:
        """Which gains are at none of their bounds, shape (p,)."""
        slack = 1e-9 * (1.0 + np.abs(gains))
        low, high = self.gain_lower + slack, self.gain_upper - slack
        return np.asarray((gains > low) & (gains < high))

    def slope(self, u: Array, gains: Array) -> Array:
        """Change of the fitted torque per coordinate at fixed gains, shape (M, s)."""
        here = self.columns(self.shapes(u)) @ gains
        slopes = np.empty((len(self.target), len(u)))
        for k in range(len(u)):
            there = u.copy()
            there[k] += _STEP if u[k] < 0.5 else -_STEP
            torque = self.columns(self.shapes(there)) @ gains
            slopes[:, k] = (torque - here) / (there[k] - u[k])
        return slopes


def roots(B: Array) -> tuple[Array, Array]:
    """A with AᵀA = BᵀB, and A⁺ᵀ; directions that B does not see are left out."""
    G = B.T @ B
    size = np.sqrt(np.diag(G))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(G / np.outer(size, size))
    seen = values > _ALIKE * values[-1]
    spread, turn = np.sqrt(values[seen])[:, None], vectors[:, seen].T
    return np.asarray(spread * turn * size), np.asarray(turn / spread / size)
