"""Linear gains under nonlinear shapes: separable least squares by variable projection.

For given shapes the best gains follow from linear least squares within their bounds, so
that only the shapes are searched. Nothing here prints.

Source: Golub and Pereyra 1973, doi 10.1137/0710036 (projection); Cameron and Miller
2015, doi 10.3368/jhr.50.2.317 (covariance from scores summed over blocks of time).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, lsq_linear
from scipy.stats import qmc
from scipy.stats import t as student

from hybrid.arrays import Array
from hybrid.errors import IdentificationError

_WIDE = 10.0  # ratio of bounds from which a shape is searched by its logarithm
_FOLLOWED = 3  # starts that are followed downhill
_STEP = 1e-6  # of a shape's range, for differences
_EDGE = 1e-4  # of a shape's range: nearer to a bound it is at the bound
_FINE, _FEWEST, _UNCORRELATED = 384, 24, 0.05  # blocks, and their correlation
_ROUGHLY = {"ftol": 1e-3, "xtol": 1e-3, "gtol": 1e-3}
_FINALLY = {"ftol": 1e-12, "xtol": 1e-12, "gtol": 1e-12}
_ALIKE = 1e-10  # singular value below which columns count as dependent
_BLIND = 1e-12  # relative curvature below which a parameter is not determined


@dataclass(frozen=True)
class Problem:
    """``target ≈ columns(shapes) @ gains + free @ others``, within bounds.

    Attributes:
        columns: Columns (M, p) for shapes (s,).
        target: What they shall explain, shape (M,).
        bounds: Lower and upper bounds of the shapes, shape (2, s).
        gain_bounds: Lower and upper bounds of the gains, shape (2, p).
        free: Columns that depend on no shape, without bounds, shape (M, m).
        block: Number of the block of time each row belongs to, ascending from 0 and
            equal for rows of one instant, shape (M,); rows in order of time by default.

    Raises:
        IdentificationError: Bounds do not fit, or there are too few rows.
    """

    columns: Callable[[Array], Array]
    target: Array
    bounds: Array
    gain_bounds: Array
    free: Array | None = None
    block: NDArray[np.intp] | None = None

    def __post_init__(self) -> None:
        low, high = self.bounds
        if not (np.all(low < high) and np.isfinite(self.bounds).all()):
            raise IdentificationError("shapes need finite bounds, lower below upper")
        unknowns = self.bounds.shape[1] + self.gain_bounds.shape[1]
        unknowns += 0 if self.free is None else self.free.shape[1]
        if len(self.target) <= unknowns:
            raise IdentificationError(
                f"{len(self.target)} samples cannot determine {unknowns} unknowns"
            )

    @cached_property
    def wide(self) -> NDArray[np.bool_]:
        """Shapes that are searched by their logarithm, shape (s,)."""
        low, high = self.bounds
        return np.asarray((low > 0) & (high >= _WIDE * low))

    def _ends(self) -> Array:
        """Bounds, of wide shapes their logarithms, shape (2, s)."""
        return np.where(
            self.wide, np.log(np.where(self.wide, self.bounds, 1.0)), self.bounds
        )

    def shapes(self, u: Array) -> Array:
        """Shapes from coordinates of 0 to 1 between their bounds, shape (s,)."""
        low, high = self._ends()
        x = low + u * (high - low)
        x = np.where(self.wide, np.exp(np.where(self.wide, x, 0.0)), x)
        return np.clip(x, *self.bounds)

    def coordinates(self, shapes: Array) -> Array:
        """Coordinates of shapes, the inverse of :meth:`shapes`; shape (s,)."""
        low, high = self._ends()
        x = np.clip(shapes, *self.bounds)
        x = np.where(self.wide, np.log(np.where(self.wide, x, 1.0)), x)
        return np.asarray((x - low) / (high - low))

    @cached_property
    def _basis(self) -> Array:
        """Orthonormal columns that span ``free``, shape (M, ≤ m)."""
        free = np.zeros((len(self.target), 0)) if self.free is None else self.free
        size = np.linalg.norm(free, axis=0)
        basis, spread, _ = np.linalg.svd(free / np.where(size > 0, size, 1.0), False)
        return np.asarray(basis[:, spread > 1e-10 * spread.max(initial=0.0)])

    def without_free(self, x: Array) -> Array:
        """What ``free`` cannot explain of some columns."""
        return np.asarray(x - self._basis @ (self._basis.T @ x))

    @cached_property
    def rest(self) -> Array:
        """What ``free`` cannot explain of the target, shape (M,)."""
        return self.without_free(self.target)

    def gains(self, u: Array) -> tuple[Array, Array]:
        """Best gains (p,) at some coordinates, and what they leave, shape (M,)."""
        B = self.without_free(self.columns(self.shapes(u)))
        size = np.linalg.norm(B, axis=0)
        size = np.where(size > 0, size, 1.0)
        R = np.linalg.qr(np.column_stack([B / size, self.rest]), mode="r")
        unit = float(np.abs(R[:, -1]).max()) or 1.0
        A, b, bounds = R[:, :-1], R[:, -1] / unit, self.gain_bounds * size / unit
        found = np.linalg.lstsq(A, b, rcond=_ALIKE)[0]
        if np.any(found < bounds[0]) or np.any(found > bounds[1]):
            found = lsq_linear(A, b, bounds, method="bvls").x
        gains = unit * found / size
        return gains, self.rest - B @ gains


@dataclass(frozen=True)
class Fit:
    """Shapes and gains with the smallest sum of squares, and how sure they are.

    Attributes:
        shapes: Shapes, shape (s,).
        gains: Gains, shape (p,).
        others: Coefficients of ``free``, shape (m,); of several that fit equally well
            the smallest.
        residual: What is left of the target, shape (M,).
        std: Standard deviation of (shapes, gains), honest under residuals that are
            correlated in time, shape (s + p,): zero for what is at a bound, infinite
            for what the data do not determine.
        degrees: Degrees of freedom of it.
        at_bound: Which of (shapes, gains) are at a bound, shape (s + p,).
        wide: Which have intervals that are symmetric in their logarithm, (s + p,).
        evaluations: How often the columns were worked out.
        converged: False if the iteration limit came first.
    """

    shapes: Array
    gains: Array
    others: Array
    residual: Array
    std: Array
    degrees: int
    at_bound: NDArray[np.bool_]
    wide: NDArray[np.bool_]
    evaluations: int
    converged: bool

    @property
    def squares(self) -> float:
        """Sum of squared residuals."""
        return float(self.residual @ self.residual)

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper ends of the confidence intervals, shapes (s + p,)."""
        theta = np.concatenate([self.shapes, self.gains])
        half = student.ppf(0.5 + level / 2, self.degrees) * self.std
        size = np.maximum(np.abs(theta), 1e-300)
        with np.errstate(over="ignore"):
            factor = np.exp(np.where(self.wide, half / size, 0.0))
        low = np.where(self.wide, theta / factor, theta - half)
        return low, np.where(self.wide, theta * factor, theta + half)


def fit_separable(
    problem: Problem, *, start: Array | None = None, starts: int = 16
) -> Fit:
    """Minimise the squares over shapes and gains within their bounds.

    Args:
        problem: Columns, target and bounds.
        start: A first guess of the shapes, shape (s,), tried besides the others.
        starts: Points of a Sobol set over the bounds that are tried, a power of 2; the
            best of them are followed downhill. 0 with a first guess that is good.
    """
    size, count = problem.bounds.shape[1], 0
    unit = float(np.linalg.norm(problem.rest)) or 1.0

    def left(u: Array) -> Array:
        nonlocal count
        count += 1
        return problem.gains(u)[1] / unit

    u, converged = np.zeros(size), True
    if size:
        tried = [] if start is None else [problem.coordinates(start)]
        if starts:
            tried += [*(qmc.Sobol(size, scramble=False).random(starts) + 0.5 / starts)]
        tried = np.clip(tried, _EDGE, 1 - _EDGE)
        order = np.argsort([np.sum(left(u) ** 2) for u in tried])
        rough = [
            least_squares(left, tried[k], bounds=(0, 1), **_ROUGHLY)
            for k in order[:_FOLLOWED]
        ]
        best = min(rough, key=lambda end: end.cost)
        end = least_squares(left, best.x, bounds=(0, 1), **_FINALLY)
        u, converged = end.x, end.status > 0
    return _with_intervals(problem, u, count, converged)


def _with_intervals(
    problem: Problem, u: Array, evaluations: int, converged: bool
) -> Fit:
    shapes, (gains, residual) = problem.shapes(u), problem.gains(u)
    columns = problem.columns(shapes)
    others: Array = np.zeros(0)
    if problem.free is not None:
        rest = problem.target - columns @ gains
        others = np.asarray(np.linalg.lstsq(problem.free, rest, rcond=1e-10)[0])
    low, high = problem.gain_bounds
    slack = 1e-9 * (1.0 + np.abs(gains))
    stuck = (gains <= low + slack) | (gains >= high - slack)
    at_bound = np.concatenate([np.minimum(u, 1 - u) < _EDGE, stuck])
    J = np.hstack([_slopes(problem, u, columns, gains), columns])[:, ~at_bound]
    J = problem.without_free(J)
    std = np.zeros(len(at_bound))
    std[~at_bound], degrees = _deviations(J, residual, problem.block)
    wide = np.concatenate([problem.wide, np.zeros(len(gains), dtype=bool)])
    found = shapes, gains, others, residual, std, degrees, at_bound, wide
    return Fit(*found, evaluations, converged)


def _slopes(problem: Problem, u: Array, columns: Array, gains: Array) -> Array:
    """Change of the fitted target with each shape at fixed gains, shape (M, s)."""
    slopes, here = np.empty((len(columns), len(u))), problem.shapes(u)
    for k in range(len(u)):
        there = u.copy()
        there[k] += _STEP if u[k] < 0.5 else -_STEP
        shapes = problem.shapes(there)
        change = (problem.columns(shapes) - columns) @ gains
        slopes[:, k] = change / (shapes[k] - here[k])
    return slopes


def _deviations(
    J: Array, residual: Array, block: NDArray[np.intp] | None
) -> tuple[Array, int]:
    """Standard deviations (p,) for derivatives J (M, p), and their degrees of freedom.

    Neighbouring blocks are joined until the scores of successive ones are unrelated.
    """
    rows = len(residual)
    if block is None:
        block = np.arange(rows) * min(_FINE, rows) // rows
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0, size, 1.0)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    scores = np.add.reduceat(J / size * residual[:, None], starts, axis=0)
    while len(scores) >= 2 * _FEWEST:
        power = np.maximum((scores**2).sum(axis=0), 1e-300)
        if np.mean((scores[1:] * scores[:-1]).sum(axis=0) / power) < _UNCORRELATED:
            break
        scores = np.add.reduceat(scores, np.arange(0, len(scores), 2), axis=0)
    values, vectors = np.linalg.eigh((J / size).T @ (J / size))
    seen = values > _BLIND * values.max(initial=0.0)
    inverse = (vectors[:, seen] / values[seen]) @ vectors[:, seen].T
    degrees = max(len(scores) - 1, 1)
    variance = len(scores) / degrees * np.sum((scores @ inverse / size) ** 2, axis=0)
    blind = (vectors[:, ~seen] ** 2).sum(axis=1) > 0.01
    return np.sqrt(np.where(blind, np.inf, variance)), degrees
