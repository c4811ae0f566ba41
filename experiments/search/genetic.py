"""What genetic searches share: a population, elitism and the best point."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.search import Best, checked_bounds, checked_values


class Genetic(ABC):
    """A population that its offspring replace, with the best kept (elitism).

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals P, an even number.
        generations: Generations of the schedule.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: int,
        generations: int,
    ) -> None:
        if population < 4 or population % 2 or generations < 1:
            raise HybridError(
                f"population {population} over {generations} generations; valid are an "
                "even number from 4 and at least one generation"
            )
        self.lower, self.upper = checked_bounds(lower, upper)
        self.population, self.generations = population, generations
        self.generation = 0
        self._rng = rng
        self._x = rng.uniform(self.lower, self.upper, (population, len(self.lower)))
        self._values = np.full(population, np.inf)
        self._asked = self._x
        self._best = Best(self._x[0], np.inf)

    @property
    def best(self) -> Best:
        """The best point of all that were told."""
        return self._best

    def ask(self) -> Array:
        """The first population, then the offspring of each, shape (P, d)."""
        self._asked = self._x if self.generation == 0 else self._offspring()
        return self._asked.copy()

    def tell(self, values: Array) -> None:
        """Let the points asked for take over, and keep the best of all (elitism)."""
        self._take_over(self._asked, checked_values(values, self.population))
        self.generation += 1

    def _take_over(self, x: Array, values: Array) -> None:
        self._x, self._values = x.copy(), values.copy()
        k = int(np.argmin(values))
        if values[k] < self._best.value:
            self._best = Best(x[k].copy(), float(values[k]))
        worst = int(np.argmax(values))
        self._x[worst], self._values[worst] = self._best.point, self._best.value

    @abstractmethod
    def _offspring(self) -> Array:
        """The next population, shape (P, d)."""
