"""Separable least squares: linear gains under nonlinear shapes, by variable projection.

For given shapes the best gains follow from linear least squares, so that only the
shapes are searched, each step with its own optimal gains.

Source: Golub and Pereyra 1973, doi 10.1137/0710036; Kaufman 1975,
doi 10.1007/BF01932995 (the Jacobian); Cameron and Miller 2015,
doi 10.3368/jhr.50.2.317 (intervals from blocks that are correlated within).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import qmc
from scipy.stats import t as student

from hybrid.errors import IdentificationError
from hybrid.robot.chain import Array

_STEP = 1e-5  # of a shape's range, for differences
_MOST_STEPS = 60
_AT_BOUND = 1e-4  # of a shape's range
_REFINED = 3  # starts that are followed to their optimum
_WIDE = 10.0  # ratio of bounds from which a shape is searched by its logarithm
_FINE_BLOCKS = 384
_FEWEST_BLOCKS = 24
_UNCORRELATED = 0.05
_BLIND = 1e-12  # relative curvature below which a parameter is not determined


@dataclass(frozen=True)
class SeparableProblem:
    """``target ≈ columns(shapes) @ gains + free @ others``, with bounds.

    Attributes:
        columns: Columns (M, p) for shapes (s,).
        target: What they shall explain, shape (M,).
        lower: Lower bounds of the shapes, shape (s,).
        upper: Upper bounds of the shapes, shape (s,).
        gain_lower: Lower bounds of the gains, shape (p,).
        gain_upper: Upper bounds of the gains, shape (p,).
        free: Columns that depend on no shape, without bounds, shape (M, m).
        block: Number of the block of time each row belongs to, ascending from 0 and
            equal for rows of one instant, shape (M,).

    Raises:
        IdentificationError: Bounds do not fit, or there are too few rows.
    """

    columns: Callable[[Array], Array]
    target: Array
    lower: Array
    upper: Array
    gain_lower: Array
    gain_upper: Array
    free: Array | None = None
    block: NDArray[np.intp] | None = None
    _wide: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not (np.all(self.lower < self.upper) and np.isfinite(self.upper).all()):
            raise IdentificationError(
                "each shape needs finite bounds, lower below upper"
            )
        unknowns = len(self.lower) + len(self.gain_lower)
        unknowns += 0 if self.free is None else self.free.shape[1]
        if len(self.target) <= unknowns:
            raise IdentificationError(
                f"{len(self.target)} samples cannot determine {unknowns} unknowns"
            )
        low = np.maximum(self.lower, 1e-300)
        wide = (self.lower > 0) & (self.upper / low >= _WIDE)
        object.__setattr__(self, "_wide", wide)

    def shapes(self, u: Array) -> Array:
        """Shapes from coordinates of 0 to 1 between their bounds, shape (s,)."""
        low, high = self.lower, self.upper
        ratio = np.where(self._wide, high / np.where(self._wide, low, 1.0), 1.0)
        found = np.where(self._wide, low * ratio**u, low + u * (high - low))
        return np.clip(found, low, high)

    @cached_property
    def _basis(self) -> Array:
        """Orthonormal columns that span ``free``, shape (M, ≤ m)."""
        assert self.free is not None
        size = np.linalg.norm(self.free, axis=0)
        Q, spread, _ = np.linalg.svd(
            self.free / np.where(size > 0, size, 1.0), full_matrices=False
        )
        return np.asarray(Q[:, spread > 1e-10 * spread[0]])

    def without_free(self, x: Array) -> Array:
        """What ``free`` cannot explain of some columns."""
        if self.free is None:
            return x
        return np.asarray(x - self._basis @ (self._basis.T @ x))

    @cached_property
    def _rest(self) -> Array:
        return self.without_free(self.target)

    def gains(self, shapes: Array) -> tuple[Array, Array, Array]:
        """Best gains for some shapes.

        Returns:
            Gains, shape (p,); the columns less what ``free`` explains of them, shape
            (M, p); what is left of the target, shape (M,).
        """
        B = self.without_free(self.columns(shapes))
        size = np.linalg.norm(B, axis=0)
        size = np.where(size > 0, size, 1.0)
        Q, R = np.linalg.qr(B / size)
        z = Q.T @ self._rest
        low, high = self.gain_lower * size, self.gain_upper * size
        g = np.linalg.lstsq(R, z, rcond=1e-12)[0]
        if np.any(g < low) or np.any(g > high):
            g = lsq_linear(R, z, bounds=(low, high), method="bvls").x
        g = g / size
        return g, B, self._rest - B @ g

    def inside(self, gains: Array) -> NDArray[np.bool_]:
        """Which gains are at none of their bounds, shape (p,)."""
        slack = 1e-9 * (1.0 + np.abs(gains))
        low, high = self.gain_lower + slack, self.gain_upper - slack
        return np.asarray((gains > low) & (gains < high))

    def slope(self, u: Array, gains: Array) -> Array:
        """Change of the fitted torque per coordinate at fixed gains, shape (M, s)."""
        slopes = np.empty((len(self.target), len(u)))
        for k in range(len(u)):
            ends = np.repeat(u[None], 2, axis=0)
            ends[:, k] = np.clip(u[k] + np.array([-_STEP, _STEP]), 0.0, 1.0)
            below, above = (self.columns(self.shapes(end)) for end in ends)
            slopes[:, k] = (above - below) @ gains / (ends[1, k] - ends[0, k])
        return slopes


@dataclass(frozen=True)
class SeparableFit:
    """Shapes and gains with the smallest sum of squares, and how sure they are.

    Attributes:
        shapes: Shapes, shape (s,).
        gains: Gains, shape (p,).
        others: Coefficients of ``free``, shape (m,); of several that fit equally well
            the smallest.
        covariance: Covariance of (shapes, gains), honest under residuals that are
            correlated in time, shape (s + p, s + p). Zero for what is at a bound,
            infinite on the diagonal for what the data do not determine.
        residual: What is left of the target, shape (M,).
        evaluations: How often the columns were worked out.
        converged: False if the iteration limit came first.
        at_bound: Which of (shapes, gains) are at a bound, shape (s + p,).
        degrees: Degrees of freedom of the covariance (blocks less one).
        logarithmic: Which of (shapes, gains) have intervals that are symmetric in their
            logarithm, shape (s + p,).
    """

    shapes: Array
    gains: Array
    others: Array
    covariance: Array
    residual: Array
    evaluations: int
    converged: bool
    at_bound: NDArray[np.bool_]
    degrees: int
    logarithmic: NDArray[np.bool_]

    @property
    def squares(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def std(self) -> Array:
        """Standard deviation of (shapes, gains), shape (s + p,)."""
        return np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper ends of the confidence intervals, shapes (s + p,)."""
        theta = np.concatenate([self.shapes, self.gains])
        half = student.ppf(0.5 + level / 2, self.degrees) * self.std
        low, high = theta - half, theta + half
        log, size = self.logarithmic, np.maximum(np.abs(theta), 1e-300)
        with np.errstate(over="ignore"):
            factor = np.exp(np.where(log, half / size, 0.0))
        return np.where(log, theta / factor, low), np.where(log, theta * factor, high)


def fit_separable(
    problem: SeparableProblem, *, start: Array | None = None, starts: int = 16
) -> SeparableFit:
    """Minimise the squares over shapes and gains within their bounds.

    Args:
        problem: Columns, target and bounds.
        start: A first guess of the shapes, shape (s,), tried besides the others.
        starts: Points of a Sobol set over the bounds that are tried, rounded up to a
            power of 2; the best of them are followed to their optimum. 0 with a first
            guess that is good.
    """
    count = [0]
    size = max(float(np.linalg.norm(problem.target)), 1e-300)  # tolerances are absolute

    def left(u: Array) -> Array:
        count[0] += 1
        return problem.gains(problem.shapes(u))[2] / size

    def jacobian(u: Array) -> Array:
        gains, B, _ = problem.gains(problem.shapes(u))
        count[0] += 1 + 2 * len(u)
        slope = problem.without_free(problem.slope(u, gains))
        Q = np.linalg.qr(B[:, problem.inside(gains)])[0]
        return np.asarray(-(slope - Q @ (Q.T @ slope)) / size)

    s = len(problem.lower)
    if s == 0:
        return _solution(problem, np.zeros(0), 1, True)
    points = _tried(problem, start, starts)
    squares = [float(np.sum(left(u) ** 2)) for u in points]
    found = [
        least_squares(left, u, jacobian, bounds=(0.0, 1.0), max_nfev=_MOST_STEPS)
        for u in points[np.argsort(squares)[:_REFINED]]
    ]
    best = min(found, key=lambda f: float(f.cost))
    return _solution(problem, best.x, count[0], bool(best.status > 0))


def _tried(problem: SeparableProblem, start: Array | None, starts: int) -> Array:
    """Coordinates to start from, shape (starts, s)."""
    points = np.zeros((0, len(problem.lower)))
    if starts or start is None:
        sobol = qmc.Sobol(len(problem.lower), scramble=False)
        points = sobol.random_base2(int(np.ceil(np.log2(max(starts, 1)))))
        points += 0.5 / len(points)  # off the corner
    if start is None:
        return points
    return np.vstack([_coordinates(problem, start), points])


def _coordinates(problem: SeparableProblem, shapes: Array) -> Array:
    low, high = problem.lower, problem.upper
    x = np.clip(shapes, low, high)
    safe = np.where(problem._wide, low, 1.0)
    log = np.log(np.where(problem._wide, x, 1.0) / safe)
    log /= np.log(np.where(problem._wide, high / safe, np.e))
    u = np.where(problem._wide, log, (x - low) / (high - low))
    return np.clip(u, _STEP, 1.0 - _STEP)


def _solution(
    problem: SeparableProblem, u: Array, evaluations: int, converged: bool
) -> SeparableFit:
    shapes = problem.shapes(u)
    gains, _, residual = problem.gains(shapes)
    columns = problem.columns(shapes)
    others: Array = np.zeros(0)
    if problem.free is not None:
        rest = problem.target - columns @ gains
        others = np.asarray(np.linalg.lstsq(problem.free, rest, rcond=1e-10)[0])
    stuck = (u < _AT_BOUND) | (u > 1.0 - _AT_BOUND)
    at_bound = np.concatenate([stuck, ~problem.inside(gains)])
    # Per unit of the shape itself, not of its coordinate.
    low, high = problem.lower, problem.upper
    log_width = np.log(np.where(problem._wide, high / np.where(low > 0, low, 1.0), 1.0))
    per_u = np.where(problem._wide, shapes * log_width, high - low)
    J = np.hstack([problem.slope(u, gains) / per_u, columns])
    J = problem.without_free(J[:, ~at_bound])
    part, degrees = _block_covariance(J, residual, problem.block)
    covariance = np.zeros((len(at_bound), len(at_bound)))
    covariance[np.ix_(~at_bound, ~at_bound)] = part
    return SeparableFit(
        shapes=shapes,
        gains=gains,
        others=others,
        covariance=covariance,
        residual=residual,
        evaluations=evaluations,
        converged=converged,
        at_bound=at_bound,
        degrees=degrees,
        logarithmic=np.concatenate([problem._wide, np.zeros(len(gains), dtype=bool)]),
    )


def _block_covariance(
    J: Array, residual: Array, block: NDArray[np.intp] | None
) -> tuple[Array, int]:
    """Covariance of J's parameters from scores of blocks; degrees of freedom."""
    rows = len(residual)
    if block is None:
        block = np.arange(rows) * min(_FINE_BLOCKS, rows) // rows
    size = np.linalg.norm(J, axis=0)
    unit = J / np.where(size > 0, size, 1.0)
    scores = np.zeros((int(block.max()) + 1, J.shape[1]))
    np.add.at(scores, block, unit * residual[:, None])
    scores = _independent(scores)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    seen = values > _BLIND * values.max(initial=0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    count = len(scores)
    spread = scores @ inverse / np.where(size > 0, size, 1.0)
    covariance = count / max(count - 1, 1) * spread.T @ spread
    blind = (vectors[:, ~seen] ** 2).sum(axis=1) > 0.01
    covariance[np.diag_indices_from(covariance)] += np.where(blind, np.inf, 0.0)
    return covariance, max(count - 1, 1)


def _independent(scores: Array) -> Array:
    """Neighbouring blocks joined until the scores of successive ones are unrelated."""
    while len(scores) >= 2 * _FEWEST_BLOCKS:
        power = np.maximum((scores**2).sum(axis=0), 1e-300)
        if np.mean((scores[1:] * scores[:-1]).sum(axis=0) / power) < _UNCORRELATED:
            break
        scores = np.add.reduceat(scores, np.arange(0, len(scores), 2), axis=0)
    return scores
