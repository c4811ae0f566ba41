"""Differential evolution that goes on while samples arrive.

Source: Storn and Price 1997, doi 10.1023/A:1008202821328 (differential evolution);
Ljung and Söderström 1983, "Theory and Practice of Recursive Identification" (the
recursive maximum-likelihood step).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.search import Best, checked_bounds, checked_values

_VANISHED = 1e-2  # of the width of the bounds


class RecursiveDifferentialEvolution:
    """One generation a sample; the difference vector is a step that the caller knows.

    Individual x becomes the trial x + K·(best − x) + F·step, crossed binomially with x;
    the better of both stays. A new sample changes the criterion, so the caller gives
    the population's new values first, by :meth:`renew`.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Individuals to start from, shape (P, d), e.g. those of a search
            over the first samples.
        factor: Weight F of the step.
        crossover: Chance of a coordinate to come from the trial.
        combination: Weight K of the way to the best.
        detour: Chance of going towards the next-best when the step has vanished; it
            keeps a population that has met in one point from freezing there.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: Array,
        factor: float = 1.2,
        crossover: float = 0.9,
        combination: float = 0.3,
        detour: float = 0.0,
    ) -> None:
        self.lower, self.upper = checked_bounds(lower, upper)
        x = np.clip(np.asarray(population, dtype=float), self.lower, self.upper)
        if x.ndim != 2 or len(x) < 2 or not 0 <= detour <= 1:
            raise HybridError(
                "two individuals or more and a detour of 0 to 1 are valid"
            )
        self.population = x
        self.factor, self.crossover = factor, crossover
        self.combination, self.detour = combination, detour
        self._rng = rng
        self._values = np.full(len(x), np.inf)
        self._step = np.zeros(x.shape[1])
        self._asked = x

    @property
    def best(self) -> Best:
        """The best individual under the present criterion."""
        k = int(np.argmin(self._values))
        return Best(self.population[k].copy(), float(self._values[k]))

    def renew(self, values: Array) -> None:
        """Values of the population under the present criterion, shape (P,)."""
        self._values = checked_values(values, len(self.population))

    def aim(self, step: Array) -> None:
        """Set the difference vector, shape (d,)."""
        self._step = np.array(step, dtype=float)

    def ask(self) -> Array:
        """One trial for each individual, shape (P, d)."""
        x, rng = self.population, self._rng
        order = np.argsort(self._values)
        vanished = np.all(np.abs(self._step) < _VANISHED * (self.upper - self.lower))
        detour = vanished & (rng.random(len(x)) < self.detour)
        goal = np.where(detour[:, None], x[order[1]], x[order[0]])
        trial = x + self.combination * (goal - x) + self.factor * self._step
        crossed = rng.random(x.shape) < self.crossover
        crossed[np.arange(len(x)), rng.integers(x.shape[1], size=len(x))] = True
        self._asked = np.clip(np.where(crossed, trial, x), self.lower, self.upper)
        return np.array(self._asked)

    def tell(self, values: Array) -> None:
        """Keep the trials that are at least as good as their individuals."""
        found = checked_values(values, len(self.population))
        better = found <= self._values
        self.population = np.where(better[:, None], self._asked, self.population)
        self._values = np.where(better, found, self._values)
