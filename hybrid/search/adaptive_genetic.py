"""A real-coded genetic algorithm whose rates depend on how fit an individual is.

Source: Srinivas and Patnaik 1994, doi 10.1109/21.286385 (adaptive rates); Michalewicz
1996, doi 10.1007/978-3-662-03315-9 (arithmetic crossover, shrinking mutation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.errors import HybridError
from hybrid.search.search import Array, Best, checked_bounds, checked_values

_SHRINKING = 2.0  # exponent with which mutations shrink over the generations


class AdaptiveGenetic:
    """Roulette, arithmetic crossover, shrinking mutation and elitism.

    An individual fitter than the average is crossed and mutated less, down to the
    second of each pair of rates for the fittest.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals P, an even number.
        generations: Generations over which mutations shrink to nothing.
        crossover: Rate for the unfit and for the fittest.
        mutation: Rate per coordinate for the unfit and for the fittest.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: int = 100,
        generations: int = 500,
        crossover: tuple[float, float] = (0.9, 0.6),
        mutation: tuple[float, float] = (0.1, 0.001),
    ) -> None:
        if population < 4 or population % 2 or generations < 1:
            raise HybridError(
                f"population {population} over {generations} generations; valid are an "
                "even number from 4 and at least one generation"
            )
        self.lower, self.upper = checked_bounds(lower, upper)
        self.population, self.generations = population, generations
        self.generation = 0
        self._crossover, self._mutation = crossover, mutation
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

    def _offspring(self) -> Array:
        rng, size = self._rng, self.population
        fitness = self._fitness()
        parents = rng.choice(size, size=size, p=fitness / fitness.sum())
        x, fit = self._x[parents], fitness[parents]
        first, second = x[0::2], x[1::2]
        rate = self._rate(np.maximum(fit[0::2], fit[1::2]), fitness, self._crossover)
        crossed = rng.random(size // 2) < rate
        share = np.where(crossed, rng.random(size // 2), 1.0)[:, None]
        x = np.concatenate(
            [share * first + (1 - share) * second, share * second + (1 - share) * first]
        )
        fit = np.concatenate([fit[0::2], fit[1::2]])
        mutated = (
            rng.random(x.shape) < self._rate(fit, fitness, self._mutation)[:, None]
        )
        return np.where(mutated, self._mutate(x), x)

    def _fitness(self) -> Array:
        """Positive where better than the worst; equal when all are alike."""
        finite = self._values[np.isfinite(self._values)]
        if finite.size == 0 or finite.max() == finite.min():
            return np.ones(self.population)
        spread = finite.max() - finite.min()
        fitness = np.clip((finite.max() - self._values) / spread, 0.0, None)
        return np.asarray(fitness + 1e-6)

    @staticmethod
    def _rate(fit: Array, fitness: Array, rates: tuple[float, float]) -> Array:
        mean, top = fitness.mean(), fitness.max()
        above = np.clip((fit - mean) / max(top - mean, 1e-300), 0.0, 1.0)
        return np.asarray(rates[0] - (rates[0] - rates[1]) * above)

    def _mutate(self, x: Array) -> Array:
        """Steps towards a random bound that shrink with the generations."""
        rng, left = self._rng, max(0.0, 1.0 - self.generation / self.generations)
        step = 1.0 - rng.random(x.shape) ** (left**_SHRINKING)
        target = np.where(rng.random(x.shape) < 0.5, self.lower, self.upper)
        return np.asarray(x + step * (target - x))
