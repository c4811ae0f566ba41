"""A genetic algorithm whose offspring are annealed: moved, and kept by chance.

Source: Ingber 1989, doi 10.1016/0895-7177(89)90202-1 (very fast annealing); Metropolis
et al. 1953, doi 10.1063/1.1699114 (acceptance).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid.search.adaptive_genetic import AdaptiveGenetic
from hybrid.search.search import Array, checked_values


class AnnealedGenetic(AdaptiveGenetic):
    """An adaptive genetic algorithm with very fast simulated annealing in every step.

    It asks twice in each generation: for the values of the offspring, then for those
    of a neighbour of each, which takes the offspring's place if it is better, and with
    probability exp(−Δ/T) if it is worse. Neighbours are far away while the temperature
    T is high; T falls by a constant factor with every generation. Δ is measured in
    spreads of the first population.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        temperature: Temperature of the first generation, in spreads of the first
            population.
        cooling: Its factor from one generation to the next.
        options: See :class:`~hybrid.search.adaptive_genetic.AdaptiveGenetic`.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        temperature: float = 0.001,
        cooling: float = 0.99,
        **options: Any,
    ) -> None:
        super().__init__(lower, upper, rng=rng, **options)
        self.temperature, self.cooling = temperature, cooling
        self._spread = 1.0
        self._annealing = False

    def ask(self) -> Array:
        """Offspring and their neighbours in turn, shape (P, d)."""
        if not self._annealing:
            return super().ask()
        self._asked = self._neighbours(self._x)
        return self._asked.copy()

    def tell(self, values: Array) -> None:
        """Values of the points asked for last, shape (P,); smaller is better."""
        values = checked_values(values, self.population)
        if not self._annealing:
            if self.generation == 0:
                finite = values[np.isfinite(values)]
                self._spread = max(
                    float(np.ptp(finite)) if finite.size else 0.0, 1e-300
                )
            self._take_over(self._asked, values)
        else:
            with np.errstate(invalid="ignore"):  # the difference of two infinities
                worse = (values - self._values) / (self._spread * self.temperature)
            chance = np.exp(-np.clip(np.nan_to_num(worse, nan=0.0), 0.0, 700.0))
            kept = self._rng.random(self.population) < chance
            x = np.where(kept[:, None], self._asked, self._x)
            self._take_over(x, np.where(kept, values, self._values))
            self.temperature *= self.cooling
            self.generation += 1
        self._annealing = not self._annealing

    def _neighbours(self, x: Array) -> Array:
        """Points at distances that scale with the temperature, within the bounds."""
        u = 2.0 * self._rng.random(x.shape) - 1.0
        T = self.temperature
        step = np.sign(u) * T * ((1.0 + 1.0 / T) ** np.abs(u) - 1.0)
        moved = x + step * (self.upper - self.lower)
        # What would leave the bounds lands between its start and the bound.
        low, high = (
            x + self._rng.random(x.shape) * (bound - x)
            for bound in (self.lower, self.upper)
        )
        moved = np.where(moved < self.lower, low, moved)
        return np.asarray(np.where(moved > self.upper, high, moved))
