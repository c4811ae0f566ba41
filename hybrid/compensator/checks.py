"""Checks of the data of a learned remainder."""

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError


def check_matrix(name: str, values: ArrayLike, columns: int | None = None) -> Array:
    """``values`` as a finite float64 matrix of ``columns`` columns.

    Raises:
        HybridError: The shape is wrong, or a number is not finite.
    """
    matrix = np.asarray(values, dtype=np.float64)
    if matrix.ndim != 2 or columns not in (None, matrix.shape[1]):
        wanted = "any" if columns is None else columns
        raise HybridError(f"{name} has shape {matrix.shape}, valid is (N, {wanted})")
    if not np.isfinite(matrix).all():
        row, column = np.argwhere(~np.isfinite(matrix))[0]
        raise HybridError(
            f"{name} is {matrix[row, column]} at row {row}, column {column}; "
            "valid are finite numbers"
        )
    return matrix


def check_pair(
    x: ArrayLike, y: ArrayLike, *, columns: tuple[int | None, int | None] = (None, None)
) -> tuple[Array, Array]:
    """Inputs and outputs as finite matrices with equal numbers of rows.

    Raises:
        HybridError: The shapes are wrong, or a number is not finite.
    """
    inputs = check_matrix("x", x, columns[0])
    outputs = check_matrix("y", y, columns[1])
    if len(inputs) != len(outputs) or 0 in (inputs.size, outputs.size):
        raise HybridError(
            f"x has shape {inputs.shape} and y {outputs.shape}, "
            "valid are equal numbers of rows and at least one column each"
        )
    return inputs, outputs


def draw(
    x: Array, y: Array, size: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw at most ``size`` rows without replacement, in their order."""
    if len(x) <= size:
        return x, y
    rows = np.sort(rng.choice(len(x), size, replace=False))
    return x[rows], y[rows]
