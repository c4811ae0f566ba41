"""Separable least squares: linear gains under nonlinear shapes, by variable projection.

For given shapes the best gains follow from linear least squares, so that only the
shapes are searched, each step with its own optimal gains.

Source: Golub and Pereyra 1973, doi 10.1137/0710036; Kaufman 1975,
doi 10.1007/BF01932995 (the Jacobian); Marquardt 1963, doi 10.1137/0111030 (the steps).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc
from scipy.stats import t as student

from hybrid.identify.block_covariance import block_covariance
from hybrid.identify.separable_problem import SeparableProblem, roots
from hybrid.robot.chain import Array

_MARGIN = 1e-5  # between a first guess and the bounds, of a shape's range
_MOST_STEPS = 60
_AT_BOUND = 1e-4  # of a shape's range
_FOLLOWED = 3  # starts that are followed downhill
_ROUGHLY, _FINALLY = 1e-3, 1e-10  # share of the squares below which a step ends it
_EXACT = 1e-28  # share of the target's squares that counts as nothing left


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
    if len(problem.lower) == 0:
        return _solution(problem, np.zeros(0), 1, True)
    starting = [_Point.at(problem, u) for u in _tried(problem, start, starts)]
    starting.sort(key=lambda point: point.squares)
    ends = [_descend(problem, p, _ROUGHLY) for p in starting[:_FOLLOWED]]
    best = min(ends, key=lambda end: end.point.squares)
    final = _descend(problem, best.point, _FINALLY)
    count = len(starting) + sum(end.evaluations for end in (*ends, final))
    return _solution(problem, final.point.u, count, final.converged)


@dataclass(frozen=True)
class _Point:
    """Coordinates with their best gains; see :meth:`SeparableProblem.gains`."""

    u: Array
    gains: Array
    B: Array
    left: Array
    squares: float

    @classmethod
    def at(cls, problem: SeparableProblem, u: Array) -> _Point:
        gains, B, left = problem.gains(problem.shapes(u))
        return cls(u, gains, B, left, float(left @ left))

    def jacobian(self, problem: SeparableProblem) -> Array:
        """Change of what is left per coordinate, gains following, shape (M, s)."""
        slope = problem.without_free(problem.slope(self.u, self.gains))
        B = self.B[:, problem.inside(self.gains)]
        if not B.shape[1]:
            return -slope
        _, inverse = roots(B)
        return np.asarray(B @ (inverse.T @ (inverse @ (B.T @ slope))) - slope)


@dataclass(frozen=True)
class _End:
    point: _Point
    evaluations: int
    converged: bool


def _descend(problem: SeparableProblem, point: _Point, tolerance: float) -> _End:
    """Levenberg–Marquardt steps, cut at the bounds, until one gains next to nothing."""
    count, damping = 0, 1e-3
    nothing = _EXACT * float(problem.target @ problem.target)
    for _ in range(_MOST_STEPS):
        J = point.jacobian(problem)
        count += 1 + len(point.u)
        slope, curvature = J.T @ point.left, J.T @ J
        held = (point.u <= 0) & (slope > 0) | (point.u >= 1) & (slope < 0)
        before = point
        while point is before:
            move = _step(slope, curvature, ~held, damping)
            u = np.clip(point.u + move, 0.0, 1.0)
            if np.abs(u - point.u).max() < 1e-9:
                return _End(point, count, True)
            trial = _Point.at(problem, u)
            count += 1
            better = trial.squares < point.squares
            damping *= 0.1 if better else 8.0
            point = trial if better else point
        gained = before.squares - point.squares
        if gained <= tolerance * before.squares or point.squares <= nothing:
            return _End(point, count, True)
    return _End(point, count, False)


def _step(
    slope: Array, curvature: Array, free: NDArray[np.bool_], damping: float
) -> Array:
    """Damped step in the coordinates that are free to move, shape (s,)."""
    move = np.zeros(len(slope))
    H = curvature[np.ix_(free, free)]
    size = np.diag(H)
    size = np.where(size > 0, size, 1.0)
    move[free] = -np.linalg.solve(H + damping * np.diag(size), slope[free])
    return move


def _tried(problem: SeparableProblem, start: Array | None, starts: int) -> Array:
    """Coordinates to start from, shape (starts, s)."""
    points = np.zeros((0, len(problem.lower)))
    if starts or start is None:
        sobol = qmc.Sobol(len(problem.lower), scramble=False)
        points = sobol.random_base2(int(np.ceil(np.log2(max(starts, 1)))))
        points += 0.5 / len(points)  # off the corner
    if start is None:
        return points
    return np.vstack(
        [np.clip(problem.coordinates(start), _MARGIN, 1.0 - _MARGIN), points]
    )


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
    per_u = problem.per_coordinate(shapes)
    J = np.hstack([problem.slope(u, gains) / per_u, columns])
    J = problem.without_free(J[:, ~at_bound])
    part, degrees = block_covariance(J, residual, problem.block)
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
        logarithmic=np.concatenate([problem.wide, np.zeros(len(gains), dtype=bool)]),
    )
