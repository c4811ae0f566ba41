"""Tabu search over continuous variables, with neighbours in hyper-rectangular rings.

Source: Chelouah and Siarry 2000, doi 10.1016/S0377-2217(99)00071-6.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hybrid.arrays import Array
from hybrid.errors import HybridError
from search.search import Best, checked_bounds, checked_values


class Tabu:
    """Moves to the best neighbour, better or worse, that is not near where it has been.

    Neighbours lie in rings of rectangles around the present point, each ring twice as
    wide as the one within. The rings shrink with the value: proportionally to it, which
    must therefore be positive and small near the optimum. A neighbour near a recent
    point is passed over, unless it is the best of all so far.

    Args:
        lower: Lower bounds, shape (d,).
        upper: Upper bounds, shape (d,).
        rng: Source of every random choice.
        start: First point, shape (d,).
        rings: Number of rings k.
        points: Neighbours in each ring.
        memory: Points that are remembered.
        tenure: Steps for which a remembered point is avoided.
        radius: Half-width of the widest ring at the start, as a share of the range.
        nearness: Half-width of the forbidden region around a remembered point, as a
            share of the widest ring.

    Raises:
        HybridError: An argument is out of range.
    """

    def __init__(
        self,
        lower: ArrayLike,
        upper: ArrayLike,
        *,
        rng: np.random.Generator,
        start: ArrayLike,
        rings: int = 4,
        points: int = 5,
        memory: int = 40,
        tenure: int = 36,
        radius: float = 0.03,
        nearness: float = 0.05,
    ) -> None:
        self.lower, self.upper = checked_bounds(lower, upper)
        here = np.array(start, dtype=float)
        if min(rings, points, memory, tenure) < 1 or radius <= 0:
            raise HybridError(
                f"{rings} rings of {points} points, memory {memory}, tenure {tenure}, "
                f"radius {radius}; valid are whole numbers from 1 and a radius above 0"
            )
        if here.shape != self.lower.shape:
            raise HybridError(
                f"start of shape {here.shape}; valid is {self.lower.shape}"
            )
        self._rng = rng
        self._here = np.clip(here, self.lower, self.upper)
        self._value = self._first = np.inf
        self._rings, self._points, self._tenure = rings, points, tenure
        self._radius, self._nearness = radius, nearness
        self._memory: deque[tuple[int, Array]] = deque(maxlen=memory)
        self._asked = self._here[None]
        self._step = 0
        self._best = Best(self._here, np.inf)

    @property
    def best(self) -> Best:
        """The best point of all that were told."""
        return self._best

    def ask(self) -> Array:
        """The start, then the neighbours of each point, shape (rings · points, d)."""
        self._asked = self._neighbours() if self._step else self._here[None]
        return np.array(self._asked)

    def tell(self, values: Array) -> None:
        """Move on."""
        values = checked_values(values, len(self._asked))
        allowed = self._is_allowed(self._asked) | (values < self._best.value)
        if allowed.any():
            k = int(np.argmin(np.where(allowed, values, np.inf)))
            self._here, self._value = self._asked[k].copy(), float(values[k])
            if self._step == 0:
                self._first = self._value
            if self._value < self._best.value:
                self._best = Best(self._here.copy(), self._value)
        self._memory.append((self._step, self._here.copy()))
        self._step += 1

    def _width(self) -> Array:
        """Half-width of the widest ring, shape (d,)."""
        shrunk = min(1.0, self._value / self._first) if self._first > 0 else 1.0
        return np.asarray(self._radius * shrunk * (self.upper - self.lower))

    def _neighbours(self) -> Array:
        rng, d = self._rng, len(self.lower)
        outer = 0.5 ** np.arange(self._rings - 1, -1, -1)
        inner = np.append(0.0, outer[:-1])
        size = rng.uniform(inner, outer, (self._points, self._rings)).T.reshape(-1, 1)
        # One coordinate lies on the rectangle of that size, the others within it.
        offset = rng.uniform(-1.0, 1.0, (len(size), d))
        edge = rng.integers(d, size=len(size))
        offset[np.arange(len(size)), edge] = rng.choice([-1.0, 1.0], size=len(size))
        x = self._here + size * offset * self._width()
        return np.asarray(np.clip(x, self.lower, self.upper))

    def _is_allowed(self, x: Array) -> NDArray[np.bool_]:
        """Whether each of the points x, shape (P, d), is away from recent ones."""
        recent = [y for step, y in self._memory if self._step - step <= self._tenure]
        if not recent:
            return np.ones(len(x), dtype=bool)
        apart: Array = np.abs(x[:, None] - np.array(recent))  # (P, memory, d)
        away = (apart >= self._nearness * self._width()).any(axis=2)
        return np.asarray(np.all(away, axis=1))
