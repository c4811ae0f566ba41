"""A real-coded genetic algorithm whose rates depend on how fit an individual is.

Source: Srinivas and Patnaik 1994, doi 10.1109/21.286385 (adaptive rates); Michalewicz
1996, doi 10.1007/978-3-662-03315-9 (arithmetic crossover, shrinking mutation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from search.genetic import Genetic

_SHRINKING = 2.0  # exponent with which mutations shrink over the generations


class AdaptiveGenetic(Genetic):
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
        super().__init__(
            lower, upper, rng=rng, population=population, generations=generations
        )
        self._crossover, self._mutation = crossover, mutation

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
