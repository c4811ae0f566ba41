"""What every population search is: ask for points, tell their values, read the best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError

Objective = Callable[[Array], Array]


@dataclass(frozen=True)
class Best:
    """The best point so far.

    Attributes:
        point: Coordinates, shape (d,).
        value: Its value; smaller is better.
    """

    point: Array
    value: float


class Search(Protocol):
    """A minimisation in steps; who calls it owns the loop and the objective."""

    @property
    def best(self) -> Best:
        """The best point of all that were told."""

    def ask(self) -> Array:
        """Points to evaluate next, shape (P, d), within the bounds."""

    def tell(self, values: Array) -> None:
        """Values of the points asked for last, shape (P,); smaller is better."""


def minimise(search: Search, objective: Objective, steps: int) -> Array:
    """Run a search and return the best value after every step.

    Args:
        search: Search to run; it holds the outcome.
        objective: Values (P,) of points (P, d), all at once.
        steps: How often to ask.

    Returns:
        Best value so far, shape (steps,).
    """
    history = np.empty(steps)
    for k in range(steps):
        search.tell(objective(search.ask()))
        history[k] = search.best.value
    return history


def checked_bounds(lower: ArrayLike, upper: ArrayLike) -> tuple[Array, Array]:
    """Bounds as arrays of shape (d,).

    Raises:
        HybridError: Shapes differ, or a lower bound is not below its upper one.
    """
    low, high = np.array(lower, dtype=float), np.array(upper, dtype=float)
    if low.ndim != 1 or low.shape != high.shape or not np.all(low < high):
        raise HybridError(
            f"search bounds {low.tolist()} to {high.tolist()}; valid are as many lower "
            "as upper ones, each below its upper one"
        )
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        raise HybridError("search bounds must be finite")
    return low, high


def checked_values(values: ArrayLike, size: int) -> Array:
    """Values as an array of shape (P,); one that is not a number counts as infinite.

    Raises:
        HybridError: There is not one value for every point.
    """
    found = np.array(values, dtype=float)
    if found.shape != (size,):
        raise HybridError(f"values of shape {found.shape}; valid is ({size},)")
    return np.where(np.isnan(found), np.inf, found)
