"""What genetic searches share: a population, elitism and the best point."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.search import Best, checked_bounds, checked_values

_SHRINKING = 2.0  # exponent with which mutations shrink over the generations


class Genetic(ABC):
    """A population that its offspring replace, with the best kept (elitism).

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals P, an even number.
        generations: Generations of the schedule.

    Source: Michalewicz 1996, doi 10.1007/978-3-662-03315-9 (arithmetic crossover,
    shrinking mutation).

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
        generations: int = 1,
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

    def _note_best(self, x: Array, values: Array) -> None:
        k = int(np.argmin(values))
        if values[k] < self._best.value:
            self._best = Best(x[k].copy(), float(values[k]))

    def _take_over(self, x: Array, values: Array) -> None:
        self._x, self._values = x.copy(), values.copy()
        self._note_best(x, values)
        worst = int(np.argmax(values))
        self._x[worst], self._values[worst] = self._best.point, self._best.value

    @abstractmethod
    def _offspring(self) -> Array:
        """The next population, shape (P, d)."""

    def _crossed(self, parents: Array, rate: float | Array) -> Array:
        """Children of pairs of parents that are crossed at a rate (arithmetic).

        Those of the first parents stand before those of the second, shape (P, d).
        """
        first, second = parents[0::2], parents[1::2]
        crossed = self._rng.random(len(first)) < rate
        share = np.where(crossed, self._rng.random(len(first)), 1.0)[:, None]
        return np.concatenate(
            [share * first + (1 - share) * second, share * second + (1 - share) * first]
        )

    def _mutate(self, x: Array) -> Array:
        """Steps towards a random bound that shrink with the generations."""
        left = max(0.0, 1.0 - self.generation / self.generations)
        step = 1.0 - self._rng.random(x.shape) ** left**_SHRINKING
        target = np.where(self._rng.random(x.shape) < 0.5, self.lower, self.upper)
        return np.asarray(x + step * (target - x))
