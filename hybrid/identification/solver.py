"""Solutions of the linear terms of an arm, chosen by their held-out error.

The candidates are the three estimators, each with a prior from the robot file of some
strength. The error of a joint is relative to the better of ordinary and weighted least
squares. A rise counts more than a fall, and a joint counts as risen unless its error
has fallen by more than one standard error.

Source: Breiman et al. 1984, "Classification and Regression Trees", section 3.4.3 (the
rule of one standard error).
"""

from collections.abc import Iterable, Sequence
from functools import partial

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.identification.preparation import summed_squares
from hybrid.identification.solution import Solution, with_zero_gains
from hybrid.regression.cross_products import CrossProducts, accumulate
from hybrid.regression.data import Data
from hybrid.regression.least_squares import (
    ESTIMATORS,
    Estimator,
    solve_weighted,
    without_folds,
)
from hybrid.regression.prior import Prior, file_prior
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot

# Number of samples that the prior is worth. Of autocorrelated residuals about a hundred
# count as one independent sample.
_STRENGTHS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e9)
_HARM = 3.0  # extra weight of a rise of a joint's error above plain least squares
_MOST_LINEARISATIONS = 8


class Solver:
    """Solves linear problems on some data."""

    def __init__(
        self, robot: Robot, data: Data, estimator: Estimator, robust: bool
    ) -> None:
        self._robot, self._data, self._robust = robot, data, robust
        self._estimators = ESTIMATORS[: ESTIMATORS.index(estimator) + 1]

    reference: Array  # squares of the better of LS and WLS, by block, shape (B, n)

    def plain(self, products: CrossProducts) -> dict[Estimator, Solution]:
        """Solutions by every estimator, without prior and bounds.

        The better of the first two at each joint is the reference of :meth:`cost`.
        """
        solution = partial(self._solution, products, bounded=False)
        found = {x: solution(x) for x in ESTIMATORS}
        ls, wls = (found[x].squares for x in ESTIMATORS[:2])
        self.reference = np.where(self.total(ls) < self.total(wls), ls, wls)
        return found

    @property
    def base(self) -> Array:
        """Sum of the reference over all blocks, shape (n,), [N²·m²]."""
        return np.maximum(self.total(self.reference), 1e-300)

    def linearised(self, products: CrossProducts) -> tuple[CrossProducts, bool]:
        """A problem linearised about the gains of effects that change signals.

        Returns:
            Its cross-products, and whether the successive linearisation converged.
        """
        for _ in range(_MOST_LINEARISATIONS):
            problem = products.problem
            theta = solve_weighted(products, self._estimators[-1], bounded=True).theta
            effects = with_zero_gains(problem.fitted(theta)[1])
            before = [x for e in problem.effects for x in e.gain_values]
            problem = build_problem(
                problem.chain, effects, inertial=problem.rigid_inertial(theta)
            )
            after = [x for e in problem.effects for x in e.gain_values]
            products = accumulate(problem, products.data)
            if np.allclose(before, after, rtol=1e-3):
                return products, True
        return products, False

    def with_effects(
        self,
        start: Solution,
        effects: Sequence[Effect],
        known: Sequence[Array] | None = None,
    ) -> Solution:
        """The best solution with other effects, at the links of ``start``.

        A known torque, shape (N, n) for each motion, [N·m], is subtracted first.
        """
        # Gains that the friction fit has set to zero stay zero, because the columns of
        # falling and rising friction are collinear.
        without = [
            (k, g.name)
            for k, e in enumerate(effects)
            for g in e.gains
            if isinstance(e, ThresholdFriction) and e.values[g.name] == 0.0
        ]
        problem = build_problem(
            self._robot.chain,
            with_zero_gains(effects),
            inertial=start.problem.rigid_inertial(start.weighted.theta),
            without=without,
        )
        products = accumulate(problem, self._data.minus(known))
        return self.best(products, start.strength)

    def best(self, products: CrossProducts, near: float | None = None) -> Solution:
        """The solution of least cost over estimators and strengths of the prior.

        Only the neighbours of a strength ``near`` are tried, if there is one.
        """
        solution = partial(self._solution, products)
        file = file_prior(products.problem, self._robot, self._data.scales)
        tried: Sequence[float] = _STRENGTHS if file is not None else (0.0,)
        if near is not None:
            at = tried.index(near)
            tried = tried[max(at - 1, 0) : at + 2]
        # First choose the strength with weighted least squares, then the estimator.
        middle = self._estimators[min(1, len(self._estimators) - 1)]
        best = self.least(solution(middle, file, x) for x in tried)
        last = [x for x in self._estimators if x != middle]
        return self.least([best, *(solution(x, file, best.strength) for x in last)])

    def _solution(
        self,
        products: CrossProducts,
        estimator: Estimator,
        file: Prior | None = None,
        strength: float = 0.0,
        *,
        bounded: bool = True,
    ) -> Solution:
        prior = file.times(strength) if file and strength else None
        found = solve_weighted(
            products, estimator, bounded=bounded, robust=self._robust, prior=prior
        )
        theta = without_folds(products, found)
        return Solution(products, found, theta, strength)

    def least(self, solutions: Iterable[Solution]) -> Solution:
        """The first solution of least cost."""
        return min(solutions, key=lambda x: self.cost(x.squares))

    def cost(self, squares: Array, harm: float = _HARM) -> float:
        """Mean log of the held-out RMS over plain LS, with a penalty on each rise."""
        total, base = np.maximum(self.total(squares), 1e-300), self.base
        level = 0.5 * np.log(total / base)
        changes = 0.5 * (squares / total - self.reference / base)  # of the log, (B, n)
        error = np.sqrt((changes**2).sum(axis=0))
        return float(np.mean(level + harm * np.maximum(level + error, 0.0)))

    def total(self, squares: Array) -> Array:
        """Sum over all blocks, shape (n,), [N²·m²]; see :func:`summed_squares`."""
        return summed_squares(squares, self._robust)

    def rms(self, squares: Array) -> Array:
        """Held-out RMS of each joint, NaN where it stands, shape (n,), [N·m]."""
        rms = np.sqrt(squares.sum(axis=0) / self._data.moving)
        return np.where(self._data.resting, np.nan, rms)
