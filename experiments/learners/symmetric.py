"""A learned remainder that keeps a symmetry, whatever it is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.compensator.gmr import check_matrix
from hybrid.compensator.gmr_fit import check_pair
from hybrid.errors import HybridError


@dataclass(frozen=True, eq=False)
class SymmetricRegression:
    """``f(x) = ½ [g(x) + p · g(s x)]``: odd (p = −1) or even (p = 1) in some inputs.

    Friction, for instance, is odd in speed: s is −1 for speeds and 1 for positions.

    Attributes:
        inner: The regression g.
        signs: The sign s of each input, shape (d,).
        parity: −1 or 1.
    """

    inner: Any
    signs: Array
    parity: float

    def __post_init__(self) -> None:
        signs = np.array(self.signs, dtype=float)
        if signs.shape != (self.inner.inputs,) or not (np.abs(signs) == 1.0).all():
            raise HybridError(f"signs are {signs}; valid is −1 or 1 for each input")
        if self.parity not in (-1.0, 1.0):
            raise HybridError(f"parity is {self.parity}, valid is −1 or 1")
        object.__setattr__(self, "signs", signs)

    @staticmethod
    def fit(
        x: ArrayLike,
        y: ArrayLike,
        *,
        signs: ArrayLike,
        parity: float,
        learn: Callable[..., Any],
        **options: Any,
    ) -> SymmetricRegression:
        """Learn from every sample and its mirror image.

        Args:
            x: Inputs, shape (N, d), any unit.
            y: Torque that the physical terms leave, shape (N, m), [N·m].
            signs: Sign of each input, shape (d,).
            parity: −1 for odd, 1 for even.
            learn: ``fit`` of the regression inside.
            **options: Passed on to it.
        """
        x, y = check_pair(x, y)
        signs = np.asarray(signs, dtype=float)
        both = np.concatenate([x, x * signs]), np.concatenate([y, parity * y])
        return SymmetricRegression(learn(*both, **options), signs, parity)

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return self.inner.inputs

    @property
    def outputs(self) -> int:
        """Number of outputs m."""
        return self.inner.outputs

    def predict(self, x: ArrayLike) -> Array:
        """Mean, shape (N, m), [N·m], as of a mixture."""
        x = check_matrix("x", x, self.inputs)
        mirrored = self.inner.predict(x * self.signs)
        return 0.5 * (self.inner.predict(x) + self.parity * mirrored)

    def predict_distribution(self, x: ArrayLike) -> tuple[Array, Array]:
        """Mean [N·m] and variance [(N·m)²], shapes (N, m)."""
        x = check_matrix("x", x, self.inputs)
        mean, variance = self.inner.predict_distribution(x)
        mirrored, spread = self.inner.predict_distribution(x * self.signs)
        return 0.5 * (mean + self.parity * mirrored), 0.5 * (variance + spread)

    def arrays(self) -> dict[str, Array]:
        """All that was learned, by name."""
        return self.inner.arrays() | {
            "signs": self.signs,
            "parity": np.array([self.parity]),
        }
