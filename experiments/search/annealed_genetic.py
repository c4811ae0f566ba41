"""A genetic algorithm whose offspring are annealed: moved, and kept by chance.

Source: Zhang, Hu and Zou 2021, doi 10.3785/j.issn.1008-973X.2021.05.001 (annealing in
every generation, cooling); Ingber 1989, doi 10.1016/0895-7177(89)90202-1 (very fast
annealing); Metropolis et al. 1953, doi 10.1063/1.1699114 (acceptance).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.adaptive_genetic import AdaptiveGenetic
from search.search import checked_values


class AnnealedGenetic(AdaptiveGenetic):
    """An adaptive genetic algorithm with very fast simulated annealing in every step.

    In each generation t it asks for the values of the offspring, then, in an inner loop
    at the temperature T = T₀ · cooling^(t/10), for those of a neighbour of each. This
    takes the individual's place if it is better, and with probability exp(−Δ/T) if it
    is worse. Neighbours are far away while the temperature is high. Δ is measured in
    spreads of the first population.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        temperature: Temperature T₀ of the first generation, in spreads of the first
            population.
        cooling: Its factor from one generation to the tenth after it.
        chain: Steps of the inner loop, in each generation; ours, as T₀ is.
        options: See :class:`~search.adaptive_genetic.AdaptiveGenetic`.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        temperature: float = 0.001,
        cooling: float = 0.99,
        chain: int = 10,
        **options: Any,
    ) -> None:
        super().__init__(lower, upper, rng=rng, **options)
        if not (temperature > 0 and 0 < cooling <= 1 and chain >= 1):
            raise HybridError(
                f"temperature {temperature}, cooling {cooling}, chain {chain}; valid "
                "are a temperature above 0, cooling up to 1 and at least one step"
            )
        self._first, self._cooling, self._chain = temperature, cooling, chain
        self._spread = 1.0
        self._step = 0  # of the inner loop; 0 for the offspring

    @property
    def temperature(self) -> float:
        """Temperature of this generation, in spreads of the first population."""
        return float(self._first * self._cooling ** (self.generation / 10))

    def ask(self) -> Array:
        """The offspring, then neighbours of the individuals, shape (P, d)."""
        if self._step == 0:
            return super().ask()
        self._asked = self._neighbours(self._x)
        return self._asked.copy()

    def tell(self, values: Array) -> None:
        """Values of the points asked for last, shape (P,); smaller is better."""
        values = checked_values(values, self.population)
        if self._step == 0:
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
        self._step = (self._step + 1) % (self._chain + 1)
        self.generation += self._step == 0

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
