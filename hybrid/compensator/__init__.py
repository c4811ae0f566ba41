"""Learned remainders of the torque that no physical term explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid.compensator.gmr import GaussianMixtureRegression

__all__ = [
    "REMAINDERS",
    "GaussianMixtureRegression",
    "Remainder",
]


class Remainder(Protocol):
    """The interface of a learned remainder.

    It is bounded, fades to zero outside its data, and refuses NaN.
    """

    kind: ClassVar[str]

    @property
    def inputs(self) -> int:
        """Number of inputs d."""

    @property
    def outputs(self) -> int:
        """Number of outputs m."""

    def predict(self, x: ArrayLike) -> NDArray[np.float64]:
        """Mean, shape (N, m), [N·m], at inputs x, shape (N, d)."""

    def predict_distribution(
        self, x: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean, shape (N, m), [N·m], and variance, shape (N, m), [(N·m)²]."""

    def arrays(self) -> dict[str, NDArray[np.float64]]:
        """Arrays to save, by name."""

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, ArrayLike]) -> Any:
        """The inverse of ``arrays``."""

    def at_instant(self, x: Sequence[Any]) -> tuple[Sequence[Any], Sequence[Any]]:
        """Mean and variance of each output, by arithmetic on scalars."""


# Kind in a model file -> class.
REMAINDERS: dict[str, type[Remainder]] = {
    GaussianMixtureRegression.kind: GaussianMixtureRegression
}
