"""Two designs of the literature as they are described, to stand beside our own.

Iterated block-weighted design: trajectories are added one by one, each optimised
jointly with those found, from random starts, until a number of tries brings nothing.
Population design: a crowding niche genetic algorithm on the condition number, limits as
a penalty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from scipy.optimize import minimize as local_minimum
from search.niche_genetic import NicheGenetic
from search.search import minimise

from hybrid.arrays import Array
from hybrid.excitation.constraints import Limits
from hybrid.excitation.criteria import Condition, Criterion, gram_condition
from hybrid.excitation.observation import Observation
from hybrid.excitation.path import Family, Grid, Path, Trajectory, uniform
from hybrid.excitation.program import MotionProgram

_TRIES = 15  # without gain
_LOCAL_STEPS = 30
_SHARP = 1e3  # so large a power is the condition number itself
_PENALTY = 1e3


@dataclass(frozen=True, eq=False)
class BlockProgram(MotionProgram):
    """A program whose criterion sees sums of the entries of each column besides.

    The information WᵀW has one more row and column: of the sums of entries of each
    column, and the number of rows in the corner.

    Attributes:
        signed: Whether sums are of entries as they are; else of their magnitudes.
    """

    signed: bool = False

    def information(self, x: Array) -> Array:
        """See :class:`MotionProgram`."""
        W = self.observation.matrix(self.grid.path(self.coefficients(x)))
        return self.known + self._bordered(W)

    def objective(self, x: Array) -> tuple[float, Array]:
        """See :class:`MotionProgram`."""
        path = self.grid.path(self.coefficients(x))
        W = self.observation.matrix(path)
        gram = self.known + self._bordered(W)
        value, slope = self.criterion.smooth(gram, self.power)
        by = 2.0 * (W @ slope[:-1, :-1] + slope[-1, :-1] * self._signs(W))
        parts = self.observation.gradient(path, by)
        return value, np.asarray((self.grid.gradient(*parts) * self.scale).ravel())

    def _signs(self, W: Array) -> Array:
        return np.ones_like(W) if self.signed else np.sign(W)

    def _bordered(self, W: Array) -> Array:
        sums = (W * self._signs(W)).sum(axis=(0, 1))
        rows = W.reshape(-1, W.shape[2])
        return np.block([[rows.T @ rows, sums[:, None]], [sums, len(rows)]])


@dataclass(frozen=True, eq=False)
class BlockCondition:
    """Weighted sum of the conditions of W, of its gravity columns and of the others.

    A column weighs std/mean of its entries, a block the mean of its columns, and the
    whole the sum of both blocks; see :class:`BlockProgram`. As printed the mean is of
    signed entries. Between two rests an acceleration has none, so that the weight of a
    column like a base's inertia is a rounding error in a denominator; the mean of
    magnitudes has a meaning for every column.

    Attributes:
        gravity: True for columns that move a torque at rest, shape (b,).
    """

    gravity: Array

    def value(self, gram: Array) -> float:
        """See :class:`Criterion`."""
        terms = self._terms(gram)
        return sum(w * gram_condition(gram[np.ix_(at, at)]) for w, _, at in terms)

    def smooth(self, gram: Array, power: float) -> tuple[float, Array]:
        """See :class:`Criterion`."""
        total, by = 0.0, np.zeros_like(gram)
        for weight, by_weight, at in self._terms(gram):
            value, slope = Condition().smooth(gram[np.ix_(at, at)], power)
            size = float(np.exp(value))
            total += weight * size
            by[np.ix_(at, at)] += weight * size * slope
            by += size * by_weight
        return float(np.log(total)), by / total

    def _terms(self, gram: Array) -> list[tuple[float, Array, Array]]:
        """Weight, its derivative by the information, and columns of each term."""
        weight, by = _variations(gram)
        terms = []
        for at in (np.flatnonzero(self.gravity), np.flatnonzero(~self.gravity)):
            if len(at):
                slope = np.zeros_like(gram)
                slope[at, at] = by[0, at] / len(at)
                slope[at, -1] = slope[-1, at] = 0.5 * by[1, at] / len(at)
                terms.append((float(weight[at].mean()), slope, at))
        whole = sum(w for w, _, _ in terms), sum(s for _, s, _ in terms)
        return [(*whole, np.arange(len(self.gravity))), *terms]


def gravity_columns(observation: Observation) -> Array:
    """True for unknowns that move a torque at rest, shape (b,)."""
    n = observation.chain.size
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (50, n))
    rest = np.zeros_like(q)
    still = observation.matrix(Path(np.arange(50.0), q, rest, rest, rest))
    size = np.abs(still).max(axis=(0, 1))
    return np.asarray(size > 1e-9 * size.max())


def _variations(gram: Array) -> tuple[Array, Array]:
    """std/mean of each column's entries, its derivatives by squares and by sums."""
    rows = gram[-1, -1]
    mean, square = gram[:-1, -1] / rows, gram.diagonal()[:-1] / rows
    spread = np.sqrt(np.maximum(square - mean**2, 1e-12 * square))
    by_square = 1.0 / (2 * spread * np.abs(mean))
    by_mean = -np.sign(mean) * (1.0 / spread + spread / mean**2)
    return spread / np.abs(mean), np.stack([by_square, by_mean]) / rows


def iterated_design(
    program: MotionProgram,
    *,
    trajectories: int,
    rng: np.random.Generator,
    tries: int = _TRIES,
) -> tuple[Trajectory, ...]:
    """Trajectories one by one, each with random restarts until nothing is gained.

    Args:
        program: Criterion, family and limits; its ``known`` is where to begin.
        trajectories: Number of motions.
        rng: Source of the starts.
        tries: Restarts without gain after which to stop.
    """
    found = []
    for _ in range(trajectories):
        program = replace(program, power=_SHARP)
        best, lowest, failed = None, np.inf, 0
        while failed < tries or best is None:
            x = _local(program, program.random(rng))
            value = program.criterion.value(program.information(x))
            if program.excess(x) <= 1e-3 and value < lowest * (1 - 1e-6):
                best, lowest, failed = x, value, 0
            else:
                failed += 1
                if best is None and failed >= 10 * tries:
                    best = _shrunk(program, x)
        found.append(program.trajectory(best))
        program = replace(program, known=program.information(best))
    return tuple(found)


def _local(program: MotionProgram, x: Array) -> Array:
    """SLSQP with one constraint for the worst sample of each limit."""

    def conditions(x: Array) -> Array:
        parts = [
            -c.excess(program.grid.path(program.coefficients(x))).max(axis=0)
            for c in program.constraints
        ]
        return np.concatenate(parts) - program.margin

    def slopes(x: Array) -> Array:
        path = program.grid.path(program.coefficients(x))
        rows = []
        for c in program.constraints:
            sample = c.excess(path).argmax(axis=0)
            slope = c.slope(path.at(sample), np.arange(len(sample)))
            by = np.einsum("kMm,Mkj->Mmj", program.grid.bases[:, sample], slope)
            rows.append(-(by * program.scale).reshape(len(sample), x.size))
        return np.concatenate(rows)

    result: Any = cast(Any, local_minimum)(
        program.objective,
        x,
        jac=True,
        method="SLSQP",
        constraints={"type": "ineq", "fun": conditions, "jac": slopes},
        options={"maxiter": _LOCAL_STEPS},
    )
    return _shrunk(program, np.asarray(result.x))


def _shrunk(program: MotionProgram, x: Array) -> Array:
    """The motion made smaller about the middle until it keeps the limits."""
    for _ in range(60):
        if program.excess(x) <= 0:
            break
        x = 0.99 * x
    return x


@dataclass(frozen=True, eq=False)
class PopulationProgram:
    """Condition number of whole populations of motions, with limits as a penalty.

    Attributes:
        observation: What is to be identified.
        criterion: What makes a motion good.
        family: Motions to choose from.
        limits: Limits of position, speed and acceleration.
        rate: Samples of the design grid per second, [Hz].
        period: Time over which a motion repeats itself, [s]: one is enough.
    """

    observation: Observation
    criterion: Criterion
    family: Family
    limits: Limits
    rate: float
    period: float

    @cached_property
    def grid(self) -> Grid:
        """One period of the design grid."""
        return Grid(self.family, uniform(self.period, self.rate)[:-1])

    @cached_property
    def bounds(self) -> Array:
        """Largest coefficients, shape (m, n): those that fill a limit by themselves."""
        x = self.limits
        sizes = ((x.high - x.low) / 2, x.speed, x.acceleration)
        reach = np.abs(self.grid.bases).max(axis=1)
        parts = [
            s / np.maximum(r[:, None], 1e-9) for s, r in zip(sizes, reach, strict=False)
        ]
        return np.asarray(np.min(parts, axis=0))

    def trajectory(self, x: Array) -> Trajectory:
        """Motion of a point, shape (m·n,)."""
        return Trajectory(self.family, x.reshape(self.bounds.shape))

    def values(self, x: Array) -> Array:
        """Criterion and penalty of P points, shape (P, m·n) -> (P,)."""
        bases, limits = self.grid.bases, self.limits
        coefficients = x.reshape(len(x), *self.bounds.shape)
        states = [np.matmul(basis, coefficients) for basis in bases]  # (P, N, n)
        q, v, a = states[:3]
        size = (limits.high - limits.low) / 2
        ratios = (
            np.abs(q - (limits.high + limits.low) / 2) / size,
            np.abs(v) / limits.speed,
            np.abs(a) / limits.acceleration,
        )
        excess = sum(np.maximum(r.max(axis=1) - 1, 0).sum(axis=1) for r in ratios)
        flat = [y.reshape(-1, y.shape[2]) for y in states]
        t = np.tile(self.grid.t, len(x))
        W = self.observation.matrix(Path(t, *flat))
        rows = W.reshape(len(x), -1, self.observation.size)
        grams = np.matmul(rows.transpose(0, 2, 1), rows)
        value = np.array([self.criterion.value(gram) for gram in grams])
        return np.asarray(value + _PENALTY * excess)


def niche_design(
    program: PopulationProgram, *, rng: np.random.Generator, generations: int = 400
) -> Trajectory:
    """The motion that the crowding niche genetic algorithm finds.

    Args:
        program: Criterion, family and limits.
        rng: Source of every random choice.
        generations: Generations of 50 individuals.
    """
    upper = program.bounds.ravel()
    search = NicheGenetic(-upper, upper, rng=rng)
    minimise(search, program.values, generations)
    return program.trajectory(search.best.point)


def set_condition(
    observation: Observation, trajectories: tuple[Trajectory, ...], rate: float
) -> float:
    """Condition number of the stacked observation matrices of several motions."""
    grams = [
        observation.gram(x.path(uniform(x.family.duration, rate))) for x in trajectories
    ]
    return gram_condition(np.asarray(sum(grams)))
