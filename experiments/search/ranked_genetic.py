"""A real-coded genetic algorithm whose pressure and rates follow a schedule.

Over the generations i of G selection sharpens, from picking at random to picking the
fit, while crossover fades and mutation grows rare and small. Source: Baker 1985
(linear ranking; Proc. 1st Int. Conf. Genetic Algorithms, p. 101).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from search.genetic import Genetic


class RankedGenetic(Genetic):
    """Linear ranking, arithmetic crossover, shrinking mutation and elitism.

    Selection pressure is 1 + i/G, the rate of crossover ``crossover`` · (1 − i/G)², and
    the rate of mutation per coordinate goes straight from one bound to the other.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals P, an even number.
        generations: Generations G of the schedule.
        crossover: Rate of crossover in the first generation.
        mutation: Rate of mutation in the first and in the last generation.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: int = 40,
        generations: int = 300,
        crossover: float = 0.95,
        mutation: tuple[float, float] = (0.2, 0.05),
    ) -> None:
        super().__init__(
            lower, upper, rng=rng, population=population, generations=generations
        )
        self._crossover, self._mutation = crossover, mutation

    def _offspring(self) -> Array:
        rng, size = self._rng, self.population
        done = min(1.0, self.generation / self.generations)
        parents = rng.choice(size, size=size, p=self._chances(1.0 + done))
        x = self._crossed(self._x[parents], self._crossover * (1.0 - done) ** 2)
        rate = self._mutation[0] + (self._mutation[1] - self._mutation[0]) * done
        mutants, mutated = self._mutate(x), rng.random(x.shape) < rate
        return np.where(mutated, mutants, x)

    def _chances(self, pressure: float) -> Array:
        """Linear in the rank: ``pressure`` times the mean for the fittest."""
        rank = np.empty(self.population)
        rank[np.argsort(-self._values, kind="stable")] = np.arange(self.population)
        share = rank / (self.population - 1)
        chances: Array = (2 - pressure + 2 * (pressure - 1) * share) / self.population
        return chances
