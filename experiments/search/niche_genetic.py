"""A genetic algorithm that keeps its individuals apart: crowding niches.

Source: De Jong 1975 (crowding); Goldberg and Richardson 1987, Genetic Algorithms and
their Applications, 41-49 (niches by sharing); the form with a penalty on the worse of
two close individuals is the common one of excitation design.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.genetic import Genetic
from search.search import checked_values


class NicheGenetic(Genetic):
    """Roulette, arithmetic crossover, uniform mutation and crowding niches.

    After every generation the offspring compete with the better half of their parents.
    Of two individuals closer than ``niche`` the worse one is penalised, so that it
    survives only where there is room.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals P.
        crossover: Probability that a pair is crossed.
        mutation: Probability that a coordinate is drawn anew.
        niche: Distance ξ below which two individuals crowd, in parts of the bounds'
            diagonal.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: int = 50,
        crossover: float = 0.4,
        mutation: float = 0.1,
        niche: float = 0.02,
    ) -> None:
        super().__init__(lower, upper, rng=rng, population=population)
        if not (0 <= crossover <= 1 and 0 <= mutation <= 1 and niche >= 0):
            raise HybridError("rates from 0 to 1 and a niche from 0 are valid")
        self._crossover, self._mutation, self._niche = crossover, mutation, niche

    def tell(self, values: Array) -> None:
        """Let the offspring compete with the better half of their parents."""
        told = checked_values(values, self.population)
        self._note_best(self._asked, told)
        self.generation += 1
        if self.generation == 1:
            self._values = told.copy()
            return
        elite = np.argsort(self._values, kind="stable")[: self.population // 2]
        x = np.concatenate([self._x[elite], self._asked])
        all_values = np.concatenate([self._values[elite], told])
        order = np.argsort(all_values, kind="stable")
        x, all_values = x[order], all_values[order]
        # Sorted, the worse of a pair is the later one; penalised, it has no offspring.
        all_values[self._crowded(x)] = np.inf
        ranked = np.argsort(all_values, kind="stable")[: self.population]
        self._x, self._values = x[ranked], all_values[ranked]

    def _crowded(self, x: Array) -> Array:
        """True for individuals with a better one nearby, x being sorted."""
        unit = (x - self.lower) / (self.upper - self.lower)
        squares = (unit**2).sum(axis=1)
        distance = squares[:, None] + squares - 2 * unit @ unit.T
        near = distance < x.shape[1] * self._niche**2
        return np.asarray(np.tril(near, -1).any(axis=1))

    def _offspring(self) -> Array:
        rng, size = self._rng, self.population
        chosen = rng.choice(size, size=size, p=self._chances())
        x = self._crossed(self._x[chosen], self._crossover)
        drawn = rng.uniform(self.lower, self.upper, x.shape)
        return np.where(rng.random(x.shape) < self._mutation, drawn, x)

    def _chances(self) -> Array:
        """Roulette on the inverse of the value, shifted so that all are positive."""
        finite = self._values[np.isfinite(self._values)]
        if finite.size == 0:
            return np.full(self.population, 1.0 / self.population)
        low = finite.min()
        shift = 0.0 if low > 0 else 1.0 - low
        chances = 1.0 / (self._values + shift + 1e-12)
        return np.asarray(chances / chances.sum())
