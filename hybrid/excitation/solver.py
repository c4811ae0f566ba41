"""Sequential quadratic programming for smooth objectives under very many conditions.

Only the conditions near their limit enter each quadratic program, so limits can be
checked on fine grids. Source: Fletcher 1985, doi 10.1007/978-3-642-82118-9, and Nocedal
and Wright 2006, doi 10.1007/978-0-387-40065-5, chapter 18 (trust region with an ℓ∞
penalty, damped BFGS).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hybrid.arrays import Array

if TYPE_CHECKING:
    from hybrid.excitation.program import MotionProgram

PENALTY = 5.0  # of the largest excess, against an objective of order 1
_FIRST_REACH, _MOST_REACH, _LEAST_REACH = 0.1, 0.5, 1e-5
_ENOUGH = 1e-6  # predicted decrease at which to stop


@dataclass(frozen=True, eq=False)
class Optimum:
    """The best point, shape (d,), and objective, largest excess and Hessian there."""

    x: Array
    value: float
    excess: float
    curvature: Array


def solve(
    program: MotionProgram,
    x: Array,
    *,
    iterations: int,
    curvature: Array | None = None,
    penalty: float = PENALTY,
) -> Optimum:
    """Minimise from a start (d,), of order 1, which may violate the conditions.

    The initial Hessian, shape (d, d), may be that of a similar program. The penalty
    weighs the largest excess.
    """
    reach = _FIRST_REACH
    B = np.eye(len(x)) if curvature is None else curvature
    value, gradient = program.objective(x)
    excess = max(0.0, program.excess(x))
    limits, slopes = program.conditions(x)
    for _ in range(iterations):
        step = quadratic_program(B, gradient, limits, slopes, reach, penalty)
        left = (limits + slopes @ step).max(initial=0.0)
        predicted = penalty * (max(excess, limits.max(initial=0.0)) - left)
        predicted -= gradient @ step + 0.5 * step @ B @ step
        if predicted < _ENOUGH or reach < _LEAST_REACH:
            break
        new_value, new_gradient = program.objective(x + step)
        new_excess = max(0.0, program.excess(x + step))
        B = _updated(B, step, new_gradient - gradient)
        gain = value - new_value + penalty * (excess - new_excess)
        if gain > 0.05 * predicted:
            x, value, gradient, excess = x + step, new_value, new_gradient, new_excess
            limits, slopes = program.conditions(x)
        if gain < 0.25 * predicted:
            reach /= 2
        elif gain > 0.7 * predicted and np.abs(step).max() > 0.9 * reach:
            reach = min(2 * reach, _MOST_REACH)
    return Optimum(x, value, excess, B)


def quadratic_program(
    B: Array,
    gradient: Array,
    limits: Array,
    slopes: Array,
    reach: float,
    penalty: float,
) -> Array:
    """Step within ``reach`` that minimises the quadratic model plus the penalty.

    Minimises gᵀs + ½ sᵀBs + c·max(0, limits + slopes·s) with every |sᵢ| ≤ reach.
    """
    import clarabel  # type: ignore[import-not-found, import-untyped, unused-ignore]
    from scipy.sparse import csc_matrix

    d = len(gradient)
    P = np.zeros((d + 1, d + 1))
    P[:d, :d] = B
    P[d, d] = 1e-8
    *box, slack = np.eye(d + 1)
    over = np.column_stack([slopes, -np.ones(len(limits))])
    rows = np.vstack([over, box, np.negative(box), -slack])
    bounds = np.concatenate([-limits, np.full(2 * d, reach), [0.0]])
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution = clarabel.DefaultSolver(
        csc_matrix(np.triu(P)), np.append(gradient, penalty), csc_matrix(rows), bounds,
        [clarabel.NonnegativeConeT(len(bounds))], settings,
    ).solve()  # fmt: skip
    step = np.array(solution.x)[:d]
    # A solver that stopped early may leave the box by a rounding error.
    return np.clip(np.where(np.isfinite(step), step, 0.0), -reach, reach)


def _updated(B: Array, step: Array, change: Array) -> Array:
    """Damped BFGS: the Hessian stays positive."""
    along = B @ step
    curve, seen = step @ along, step @ change
    if seen < 0.2 * curve:
        share = 0.8 * curve / (curve - seen)
        change = share * change + (1 - share) * along
        seen = step @ change
    if min(curve, seen) < 1e-14:
        return B
    return np.asarray(
        B - np.outer(along, along) / curve + np.outer(change, change) / seen
    )
