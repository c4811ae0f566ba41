"""A real-coded genetic algorithm whose pressure and rates follow a schedule.

Over the generations i of G selection sharpens, from picking at random to picking the
fit, while crossover fades and mutation grows rare and small. Sources: Baker 1985
(linear ranking; Proc. 1st Int. Conf. Genetic Algorithms, p. 101); Michalewicz 1996,
doi 10.1007/978-3-662-03315-9 (arithmetic crossover, shrinking mutation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from search.genetic import Genetic

_SHRINKING = 2.0  # exponent with which mutations shrink over the generations


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
        first, second = self._x[parents[0::2]], self._x[parents[1::2]]
        crossed = rng.random(size // 2) < self._crossover * (1.0 - done) ** 2
        share = np.where(crossed, rng.random(size // 2), 1.0)[:, None]
        x = np.concatenate(
            [share * first + (1 - share) * second, share * second + (1 - share) * first]
        )
        rate = self._mutation[0] + (self._mutation[1] - self._mutation[0]) * done
        step = 1.0 - rng.random(x.shape) ** ((1.0 - done) ** _SHRINKING)
        target = np.where(rng.random(x.shape) < 0.5, self.lower, self.upper)
        mutated = rng.random(x.shape) < rate
        return np.where(mutated, x + step * (target - x), x)

    def _chances(self, pressure: float) -> Array:
        """Linear in the rank: ``pressure`` times the mean for the fittest."""
        rank = np.empty(self.population)
        rank[np.argsort(-self._values, kind="stable")] = np.arange(self.population)
        share = rank / (self.population - 1)
        chances: Array = (2 - pressure + 2 * (pressure - 1) * share) / self.population
        return chances
