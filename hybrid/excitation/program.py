"""The optimisation problem of one or several motions: criterion, limits and grids."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from hybrid.arrays import Array, Mask
from hybrid.excitation.constraints import Constraint, Limits
from hybrid.excitation.criteria import Criterion
from hybrid.excitation.observation import Observation
from hybrid.excitation.path import Family, Grid, Path, Trajectory, uniform

FINER = 10  # rate of the grid on which limits are verified, over that of the design
_ACTIVE = 0.5  # conditions this close to their limit enter a step
_ACTIVE_NEIGHBOUR = 0.1  # ... and this close, with the samples beside them
_MOST_START_EXCESS = 0.1  # a random start with a larger excess is made smaller
_SHRINKS = 8
_POSTURES = 300
_USAGE = 20  # random motions as examples of future ones
_CACHE_SIZE = 16  # motions


@dataclass(frozen=True, eq=False)
class MotionProgram:
    """The optimisation of T motions of a family in scaled coordinates, shape (T·m·n,).

    The unit of a coordinate is the coefficient that reaches a limit alone, so that a
    step of 0.1 is small for every joint and basis function.
    """

    observation: Observation
    criterion: Criterion
    family: Family
    constraints: Sequence[Constraint]
    limits: Limits  # for the scale of the coordinates
    known: Array  # information of motions chosen before, shape (b, b)
    rate: float  # samples of the design grid per second, [Hz]
    power: float  # sharpness of the criterion, see Criterion
    margin: float  # share of every limit that is kept free
    count: int = 1  # motions T that are optimised together

    @cached_property
    def grid(self) -> Grid:
        """The design grid."""
        return Grid(self.family, uniform(self.family.duration, self.rate))

    @cached_property
    def fine(self) -> Grid:
        """The grid on which limits are verified."""
        return Grid(self.family, uniform(self.family.duration, FINER * self.rate))

    @property
    def middle(self) -> Array:
        """Coefficients of standstill in the middle of the range, shape (m, n)."""
        return np.outer(self.constant, self.limits.middle)

    @cached_property
    def scale(self) -> Array:
        """Size of each coefficient that alone reaches a limit, shape (m, n)."""
        reach = np.abs(self.fine.bases).max(axis=1)[:, :, None]  # (4, m, 1)
        sizes = self.limits.sizes[:, None]
        return np.asarray((sizes / np.maximum(reach, 1e-9)).min(axis=0))

    def coefficients(self, x: Array) -> Array:
        """Coefficients of one motion, shape (m, n), from its coordinates (m·n,)."""
        return np.asarray(self.middle + self.scale * x.reshape(self.scale.shape))

    def trajectory(self, x: Array) -> Trajectory:
        """Motion of coordinates of shape (m·n,)."""
        return Trajectory(self.family, self.coefficients(x))

    def parts(self, x: Array) -> Array:
        """Coordinates of each motion of a point, shape (T, m·n)."""
        return x.reshape(self.count, -1)

    def point(self, trajectory: Trajectory) -> Array:
        """Coordinates of a motion, shape (m·n,)."""
        offset = trajectory.coefficients - self.middle
        return np.asarray((offset / self.scale).ravel())

    def paths(self, x: Array, grid: Grid) -> list[Path]:
        """Samples of each motion of a point."""
        return [grid.path(self.coefficients(part)) for part in self.parts(x)]

    def random(self, rng: np.random.Generator) -> Array:
        """Random motions about random postures as a start, shape (T·m·n,)."""
        return np.concatenate([self._random(rng, 0.8) for _ in range(self.count)])

    def _random(self, rng: np.random.Generator, fill: float) -> Array:
        """One motion; it fills a share of the joint limits, or less for the others."""
        x = rng.standard_normal(self.scale.shape)
        for j in range(x.shape[1]):
            path = self.fine.bases @ (self.scale[:, j] * x[:, j])  # (4, N)
            x[:, j] *= fill / (np.abs(path).max(axis=1) / self.limits.sizes[:, j]).max()
        center = self._posture(rng)
        for factor in 0.7 ** np.arange(_SHRINKS):
            start = (center + factor * x).ravel()
            if self._excess(start) < _MOST_START_EXCESS:
                break
        return np.asarray(start)

    def usage(self, rng: np.random.Generator) -> list[Path]:
        """Random motions within the limits, as examples of future motions."""
        points = [self._random(child, 1.0) for child in rng.spawn(_USAGE)]
        return [self.grid.path(self.coefficients(x)) for x in points]

    def _posture(self, rng: np.random.Generator) -> Array:
        """Coordinates of standstill in a posture without collisions, shape (m, n)."""
        if all(constraint.is_linear for constraint in self.constraints):
            return np.zeros_like(self.scale)
        still = self._postures(rng)
        found = [c.excess(still).max(axis=1, initial=-1.0) for c in self.constraints]
        best = still.q[np.max(found, axis=0).argmin()]
        shift = best - self.limits.middle
        return np.asarray(self.constant[:, None] * shift / self.scale)

    def _postures(self, rng: np.random.Generator) -> Path:
        """The arm at rest in random postures within the middle half of its range."""
        low, high = self.limits.low, self.limits.high
        q = low + (high - low) * rng.uniform(0.25, 0.75, (_POSTURES, len(low)))
        rest = np.zeros_like(q)
        return Path(np.arange(float(_POSTURES)), q, rest, rest, rest)

    @cached_property
    def constant(self) -> Array:
        """Coefficients of a joint at rest at 1 rad, shape (m,)."""
        one = np.ones(len(self.grid.t))
        return np.asarray(np.linalg.lstsq(self.grid.bases[0], one, rcond=None)[0])

    def information(self, x: Array) -> Array:
        """Information of the motions and of those chosen before, shape (b, b)."""
        grams = map(self.observation.gram, self.paths(x, self.grid))
        return np.asarray(self.known + sum(grams))

    def objective(self, x: Array) -> tuple[float, Array]:
        """The criterion of all motions, and its gradient, shape (T·m·n,)."""
        paths = self.paths(x, self.grid)
        matrices = [self.observation.matrix(path) for path in paths]
        rows = [W.reshape(-1, self.observation.size) for W in matrices]
        gram = self.known + np.asarray(sum(W.T @ W for W in rows))
        value, by = self.criterion.smooth(gram, self.power)
        slopes = []
        for path, W in zip(paths, matrices, strict=True):
            seen = self.observation.gradient(path, 2.0 * (W @ by))
            slopes.append((self.grid.gradient(*seen) * self.scale).ravel())
        return value, np.concatenate(slopes)

    def conditions(self, x: Array) -> tuple[Array, Array]:
        """Conditions near their limit: excess, (M,), and slope, (M, T·m·n)."""
        found = [self._conditions(part) for part in self.parts(x)]
        values, slopes = zip(*found, strict=True)
        return np.concatenate(values), block_diag(*slopes)

    def _conditions(self, x: Array) -> tuple[Array, Array]:
        """Conditions of one motion, shapes (M,) and (M, m·n)."""
        values, slopes = [np.zeros(0)], [np.zeros((0, x.size))]
        for constraint, grid, path, found in self._excesses(x):
            excess = found + self.margin
            peaks = _peaks(excess)
            if not constraint.is_linear:
                # A step may move a sharp peak to the next sample of the coarse grid.
                neighbour = np.zeros_like(peaks)
                neighbour[1:] = peaks[:-1]
                neighbour[:-1] |= peaks[1:]
                peaks |= neighbour & (excess > -_ACTIVE_NEIGHBOUR)
            sample, which = np.nonzero(peaks & (excess > -_ACTIVE))
            slope = constraint.slope(path.at(sample), which)  # (M, 4, n)
            by = np.einsum("kMm,Mkj->Mmj", grid.bases[:, sample], slope)
            values.append(excess[sample, which])
            slopes.append((by * self.scale).reshape(len(sample), x.size))
        return np.concatenate(values), np.concatenate(slopes)

    def excess(self, x: Array) -> float:
        """Largest excess of all conditions; feasible if not above zero."""
        return max(map(self._excess, self.parts(x)))

    def _excess(self, x: Array) -> float:
        every = [found.max(initial=-np.inf) for *_, found in self._excesses(x)]
        return float(max(every, default=-np.inf)) + self.margin

    def _excesses(self, x: Array) -> list[tuple[Constraint, Grid, Path, Array]]:
        """Each constraint, its grid, samples of one motion, and the excess in them.

        They are cached, because the solver needs them for the excess of a step and
        again for its slopes.
        """
        key = x.tobytes()
        if key not in self._cache:
            if len(self._cache) >= _CACHE_SIZE:
                self._cache.clear()
            coefficients, found = self.coefficients(x), []
            for c in self.constraints:
                grid = self.fine if c.is_linear else self.grid
                path = grid.path(coefficients)
                found.append((c, grid, path, c.excess(path)))
            self._cache[key] = found
        return self._cache[key]

    @cached_property
    def _cache(self) -> dict[bytes, list[tuple[Constraint, Grid, Path, Array]]]:
        return {}

    def impossible(self) -> tuple[str, ...]:
        """Names of conditions that no random posture satisfies."""
        still, found = self._postures(np.random.default_rng(0)), []
        for c in self.constraints:
            if not c.is_linear:
                over = c.excess(still).min(axis=0) > 0
                found += [c.names[k] for k in np.flatnonzero(over)]
        return tuple(dict.fromkeys(found))  # a name may stand for several conditions

    def verified(self, x: Array) -> dict[str, float]:
        """Largest excess of each condition on the fine grid, without the margin."""
        found: dict[str, float] = {}
        for path in self.paths(x, self.fine):
            for constraint in self.constraints:
                worst = constraint.excess(path).max(axis=0, initial=-np.inf)
                for name, excess in zip(constraint.names, worst, strict=True):
                    found[name] = max(float(excess), found.get(name, -np.inf))
        return found


def _peaks(x: Array) -> Mask:
    """True at local maxima along the first axis, and at both ends."""
    edge = np.full((1, x.shape[1]), -np.inf)
    rises = x >= np.concatenate([edge, x[:-1]])
    falls = x > np.concatenate([x[1:], edge])
    return np.asarray(rises & falls, dtype=bool)
