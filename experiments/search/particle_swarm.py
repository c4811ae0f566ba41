"""A swarm of particles that fly towards the best points seen, on their own and by all.

Source: Kennedy and Eberhart 1995, doi 10.1109/ICNN.1995.488968 (the swarm); Shi and
Eberhart 1998, doi 10.1109/ICEC.1998.699146 (inertia).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.search import Best, checked_bounds, checked_values


class ParticleSwarm:
    """Velocity = inertia · velocity + pull to the own best + pull to the swarm's best.

    Each pull is a uniform random share of its weight, drawn anew for every coordinate;
    the inertia falls linearly over the iterations. A particle that would leave the
    bounds, or go farther than ``fastest`` in one iteration, is stopped there.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        population: Particles P, at least two.
        iterations: Iterations over which the inertia falls.
        inertia: Its value in the first and from the last of these iterations.
        cognitive: Weight of the pull to a particle's own best.
        social: Weight of the pull to the best of all.
        fastest: Largest step of a coordinate, as a share of its range.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        population: int = 80,
        iterations: int = 200,
        inertia: tuple[float, float] = (0.9, 0.4),
        cognitive: float = 2.0,
        social: float = 2.0,
        fastest: float = 0.5,
    ) -> None:
        self.lower, self.upper = checked_bounds(lower, upper)
        if population < 2 or iterations < 1 or not 0 < fastest <= 1:
            raise HybridError(
                f"{population} particles, {iterations} iterations, fastest {fastest}; "
                "valid are two particles or more, an iteration or more, and 0 to 1"
            )
        self.iteration, self.iterations = 0, iterations
        self._rng, self._inertia = rng, inertia
        self._cognitive, self._social = cognitive, social
        self._fastest = fastest * (self.upper - self.lower)
        self._x = rng.uniform(self.lower, self.upper, (population, len(self.lower)))
        self._v = np.zeros_like(self._x)
        self._own, self._values = self._x.copy(), np.full(population, np.inf)

    @property
    def best(self) -> Best:
        """The best point of all that the particles remember."""
        k = int(np.argmin(self._values))
        return Best(self._own[k].copy(), float(self._values[k]))

    @property
    def remembered(self) -> Array:
        """The best point of each particle, shape (P, d)."""
        return self._own.copy()

    def renew(self, values: ArrayLike) -> None:
        """Values of the remembered points under a new criterion, shape (P,)."""
        self._values = checked_values(values, len(self._own))

    def ask(self) -> Array:
        """Where the particles are, shape (P, d)."""
        if self.iteration:
            self._fly()
        return self._x.copy()

    def tell(self, values: ArrayLike) -> None:
        """Values of the points asked for last, shape (P,); smaller is better."""
        found = checked_values(values, len(self._x))
        better = found < self._values
        self._own = np.where(better[:, None], self._x, self._own)
        self._values = np.where(better, found, self._values)
        self.iteration += 1

    def _fly(self) -> None:
        first, last = self._inertia
        done = min(1.0, self.iteration / self.iterations)
        own, all_ = self._rng.random((2, *self._x.shape))
        v = (first + done * (last - first)) * self._v
        v += self._cognitive * own * (self._own - self._x)
        v += self._social * all_ * (self.best.point - self._x)
        there = self._x + np.clip(v, -self._fastest, self._fastest)
        there = np.clip(there, self.lower, self.upper)
        self._v, self._x = there - self._x, there
