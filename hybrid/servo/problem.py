"""The most probable values of some numbers: Gauss–Newton on replays.

    J(x) = Σ_j w_j Σ_k ρ(e_jk) + ½ Σ ((x − x_file) / s)²

e is what a replay misses of the measured position, w and ρ are of
:class:`hybrid.servo.noise.Noise`. A servo moves its own joint before others: numbers of
one kind are changed at all joints at once, and each joint shows its own slope; masses,
which move all joints, are changed one by one. J is a sum over joints: each takes the
step that suits it. The last slopes, which the covariance needs, are made one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.servo.drive import QUANTITIES, Drive
from hybrid.servo.noise import Noise, inexactness, resolution, usual_error
from hybrid.servo.simulator import ServoSimulator
from hybrid.servo.stretch import Stretch

_ENDS = 5e-3  # relative fall of the cost that is not worth another step
_DAMPINGS = (0.01, 1.0, 100.0)
_LARGEST = 1.0  # step of a logarithm; of other numbers in prior deviations
_PROBE = 0.05  # the same for slopes
_LEAST = 1e-4  # rad: of an encoder without steps
_KEPT = 64 * 2**20  # bytes of replays that are remembered
LOGARITHMIC = np.array([q.positive for q in QUANTITIES])[:, None]
SHARED = np.array([q.shared for q in QUANTITIES])


@dataclass(frozen=True, eq=False)
class Estimate:
    """Servos at which a search ended.

    Attributes:
        x: Coordinates, shape (len(QUANTITIES), n).
        free: Which of them were fitted, P of them.
        errors: What replays miss there, shape (M, n), [rad].
    """

    x: Array
    free: NDArray[np.bool_]
    errors: Array

    @cached_property
    def usual(self) -> Array:
        """Usual error of replays, shape (n,), [rad]."""
        return usual_error(self.errors)


@dataclass(frozen=True, eq=False)
class Problem:
    """Logs, and what is known of servos before.

    Attributes:
        simulator: Replays.
        stretches: Logs.
        prior: Numbers of the robot file.
        resting: Joints that no log moves, shape (n,).
        reached: Least and largest position in any log, shape (2, n), [rad].
        touched: Least height in any log of links' centres of mass, if their command
            went lower, else NaN, shape (n,), [m].
    """

    simulator: ServoSimulator
    stretches: Sequence[Stretch]
    prior: Drive
    resting: NDArray[np.bool_]
    reached: Array
    touched: Array | float = np.nan
    _known: dict[bytes, Array] = field(default_factory=dict)

    def over(self, stretches: Sequence[Stretch]) -> Problem:
        """The same with other stretches."""
        return replace(self, stretches=stretches, _known={})

    @property
    def measured(self) -> Array:
        """Positions of all stretches, shape (M, n), [rad]."""
        return np.concatenate([x.q for x in self.stretches])

    @cached_property
    def _limits(self) -> tuple[Array, Array]:
        """Least usual error [rad], and density of what laws leave out [rad²], (n,)."""
        floor = np.maximum(resolution(self.stretches), _LEAST)
        return floor, inexactness(self.stretches)

    def noise(self, errors: Array) -> Noise:
        """Noise as it shows in what a good replay misses, shape (M, n), [rad]."""
        ends = np.cumsum([len(x.q) for x in self.stretches])
        return Noise.of(np.split(errors, ends[:-1]), *self._limits)

    @property
    def step(self) -> Array:
        """Prior deviations, or 1 of logarithms, shape (len(QUANTITIES), n)."""
        return np.where(LOGARITHMIC, 1.0, self.prior.spread)

    def errors(self, points: Sequence[Array]) -> list[Array]:
        """What replays miss at some coordinates, shape (M, n) each, [rad]."""
        drives = {x.tobytes(): self.prior.moved(x) for x in points}
        new = {key: x for key, x in drives.items() if key not in self._known}
        if new:
            measured, known = self.measured, self._known
            found = self.simulator.replay(self.stretches, list(new.values()))
            for key, q in zip(new, found, strict=True):
                known[key] = np.nan_to_num(np.concatenate(q) - measured, nan=1e3)
        out = [self._known[x.tobytes()] for x in points]
        while out and len(self._known) * out[0].nbytes > _KEPT:
            del self._known[next(iter(self._known))]
        return out

    def at(self, x: Array, free: NDArray[np.bool_]) -> Estimate:
        """Servos as they are, before a search."""
        return Estimate(x, free, self.errors([x])[0])

    def off(self, x: Array, free: NDArray[np.bool_]) -> Array:
        """Half the squared distance from the prior at each joint, shape (n,)."""
        z = np.where(free, (x - self.prior.coordinates) / self.prior.spread, 0.0)
        return np.asarray(0.5 * (z**2).sum(axis=0))

    def cost(self, found: Estimate, noise: Noise) -> Array:
        """Negative log posterior but for a constant, of each joint, shape (n,)."""
        return noise.cost(found.errors) + self.off(found.x, found.free)

    def slopes(self, found: Estimate, *, each: bool = False) -> Array:
        """Change of errors per unit of every free coordinate, (P, M, n).

        Args:
            found: Where.
            each: Change one number after the other, and see it at all joints.
        """
        alone = found.free & (SHARED[:, None] | each)
        kinds = np.flatnonzero((found.free & ~alone).any(axis=1)).tolist()
        rows: list[Any] = [*kinds, *map(tuple, np.argwhere(alone).tolist())]
        probe, moved, n = _PROBE * self.step, [], np.arange(self.prior.stall.size)
        for row in rows:
            y = found.x.copy()
            y[row] += probe[row]
            moved.append(y)
        out = np.zeros((*found.free.shape, *found.errors.shape))
        for row, after in zip(rows, self.errors(moved), strict=True):
            slope = (after - found.errors) / probe[row]
            if isinstance(row, tuple):
                out[row] = slope
            else:
                out[row, n, :, n] = slope.T  # each joint its own
        return np.asarray(out[found.free])

    def normal(
        self,
        found: Estimate,
        slopes: Array,
        noise: Noise,
        spread: Array | None = None,
    ) -> tuple[Array, Array]:
        """Matrix and gradient of the log posterior.

        Args:
            found: Where.
            slopes: From :meth:`slopes`, shape (P, M, n).
            noise: How errors count.
            spread: Prior deviations if not those of the file, (len(QUANTITIES), n).
        """
        spread = self.prior.spread if spread is None else spread
        weight = noise.weights(found.errors)
        flat = slopes.reshape(len(slopes), -1)
        matrix = (flat * weight.ravel()) @ flat.T
        gradient = flat @ (weight * found.errors).ravel()
        inverse = 1.0 / spread[found.free] ** 2
        matrix += np.diag(inverse)
        away = (found.x - self.prior.coordinates)[found.free]
        return matrix, gradient + inverse * away

    def fitted(self, start: Estimate, noise: Noise | None, turns: int) -> Estimate:
        """The most probable values of what is free.

        Args:
            start: Where the search begins.
            noise: How errors count; None for as much as those of the step before.
            turns: Most Gauss–Newton steps.
        """
        found = start
        for _ in range(turns if start.free.any() else 0):
            own = noise or self.noise(found.errors)
            before = self.cost(found, own)
            found = self._step(found, own)
            if (before - self.cost(found, own) < _ENDS * before).all():
                break
        return found

    def _step(self, found: Estimate, noise: Noise) -> Estimate:
        """The best of several damped Gauss–Newton steps, at each joint."""
        matrix, gradient = self.normal(found, self.slopes(found), noise)
        most, tried = (_LARGEST * self.step)[found.free], []
        for damping in _DAMPINGS:
            damped = matrix + damping * np.diag(np.diagonal(matrix))
            y = found.x.copy()
            y[found.free] += np.clip(-np.linalg.solve(damped, gradient), -most, most)
            tried.append(self.prior.moved(y).coordinates)
        ends = [
            replace(found, x=y, errors=e)
            for y, e in zip(tried, self.errors(tried), strict=True)
        ]
        costs = np.array([self.cost(x, noise) for x in [found, *ends]])
        points = np.array([found.x, *tried])
        mixed = np.take_along_axis(points, costs.argmin(axis=0)[None, None, :], 0)[0]
        ends.append(self.at(mixed, found.free))
        return min([found, *ends], key=lambda x: float(self.cost(x, noise).sum()))

    def covariance(self, found: Estimate, noise: Noise) -> Array:
        """Posterior covariance of what is free, shape (P, P)."""
        matrix, _ = self.normal(found, self.slopes(found, each=True), noise)
        return np.asarray(np.linalg.inv(matrix))
