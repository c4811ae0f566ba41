"""A real-coded genetic algorithm whose rates depend on how fit an individual is.

Source: Srinivas and Patnaik 1994, doi 10.1109/21.286385 (adaptive rates).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from search.genetic import Genetic


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
        fit = fitness[parents]
        rate = self._rate(np.maximum(fit[0::2], fit[1::2]), fitness, self._crossover)
        x = self._crossed(self._x[parents], rate)
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
