"""How the linear terms of an arm are solved, and how good a solution is.

The rungs of stage one: least squares, weighted by the variance of each joint, by the
full covariance across joints, each with the robot file as a prior of some strength.
What counts is the held-out error of every joint, against the better of least squares
and weighted least squares.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.identification.data import FOLDS, Data
from hybrid.identification.preparation import scored, total
from hybrid.identification.solution import Solution, to_be_found
from hybrid.regression.least_squares import (
    ESTIMATORS,
    Estimator,
    settle,
    without_folds,
)
from hybrid.regression.prior import Prior, file_prior
from hybrid.regression.problem import Problem, build_problem
from hybrid.robot import Robot

# How many samples the prior is worth: noise that lasts lets a hundred count for one.
_STRENGTHS = (0.0, 1.0, 10.0, 100.0, 1e3, 1e9)
_HARM = 3.0  # weight of a joint's rise above plain least squares against any fall
_MOST_LINEARISATIONS = 8


class Solver:
    """Solutions of linear problems on some data.

    Args:
        robot: The arm.
        data: Motions with folds.
        estimator: The last way to weigh joints that may be taken.
        robust: Weigh down stretches that do not fit.
    """

    def __init__(
        self, robot: Robot, data: Data, estimator: Estimator, robust: bool
    ) -> None:
        self._robot, self._data, self._robust = robot, data, robust
        self._estimators = ESTIMATORS[: ESTIMATORS.index(estimator) + 1]
        self.base: Array = np.ones(robot.size)

    def plain(self, problem: Problem) -> dict[Estimator, Solution]:
        """Solutions by every estimator, without a prior or bounds.

        The better of the first two at each joint is what others are held against.
        """
        data = self._data
        found = {x: self._tried(data, problem, x, bounded=False) for x in ESTIMATORS}
        squares = [self.total(found[x].squares) for x in ESTIMATORS[:2]]
        self.base = np.maximum(np.min(squares, axis=0), 1e-300)
        return found

    def linearised(self, problem: Problem) -> tuple[Problem, bool]:
        """The problem around the values that signal-changing effects settle at.

        Returns:
            It, and whether they settle.
        """
        for _ in range(_MOST_LINEARISATIONS):
            products = self._data.products(problem)
            theta = settle(products, self._estimators[-1]).theta
            effects = to_be_found(problem.fitted(theta)[1])
            before = [x for e in problem.effects for x in e.gain_values]
            problem = build_problem(
                problem.chain, effects, inertial=problem.rigid_inertial(theta)
            )
            after = [x for e in problem.effects for x in e.gain_values]
            if np.allclose(before, after, rtol=1e-3):
                return problem, True
        return problem, False

    def with_effects(
        self,
        start: Solution,
        effects: Sequence[Effect],
        known: Sequence[Array] | None = None,
    ) -> Solution:
        """The best solution with other effects, from the load of one there is.

        Args:
            start: The solution there is.
            effects: Effects; their shapes are as given.
            known: Torque already explained, shape (N, n) for each motion, [N·m].
        """
        # What stage two left at zero stays there: its opposites would be collinear.
        without = [
            (k, g.name)
            for k, e in enumerate(effects)
            for g in e.gains
            if isinstance(e, ThresholdFriction) and e.values[g.name] == 0.0
        ]
        problem = build_problem(
            self._robot.chain,
            to_be_found(effects),
            inertial=start.problem.rigid_inertial(start.settled.theta),
            without=without,
        )
        return self.best(problem, known)

    def best(self, problem: Problem, known: Sequence[Array] | None = None) -> Solution:
        """The rungs of stage one that predict unseen samples best.

        Args:
            problem: The unknowns.
            known: Torque already explained, shape (N, n) for each motion, [N·m].
        """
        data = self._data.less(known)
        file = file_prior(problem, self._robot, self._data.scales)
        strengths = _STRENGTHS if file is not None else _STRENGTHS[:1]
        priors = [file.times(x) if file and x else None for x in strengths]
        # The strength first, by the estimator between the others; then the estimator.
        middle = self._estimators[min(1, len(self._estimators) - 1)]
        best = min(
            (self._tried(data, problem, middle, x) for x in priors),
            key=lambda x: self.cost(x.squares),
        )
        others = [x for x in self._estimators if x != middle]
        return min(
            [best, *(self._tried(data, problem, x, best.prior) for x in others)],
            key=lambda x: self.cost(x.squares),
        )

    def _tried(
        self,
        data: Data,
        problem: Problem,
        estimator: Estimator,
        prior: Prior | None = None,
        *,
        bounded: bool = True,
    ) -> Solution:
        products = data.products(problem)
        settled = settle(
            products, estimator, bounded=bounded, robust=self._robust, prior=prior
        )
        theta = without_folds(
            products,
            settled.weight,
            bounded=bounded,
            prior=prior,
            folds=FOLDS,
            share=settled.share,
        )
        squares = scored(products, theta)
        return Solution(data, products, settled, prior, bounded, theta, squares)

    def cost(self, squares: Array, harm: float = _HARM) -> float:
        """Mean log of the held-out RMS, and of its rise above plain LS besides.

        Args:
            squares: Held-out squares of each block, shape (B, n), [N²·m²].
            harm: Weight of the rise.
        """
        level = 0.5 * np.log(np.maximum(self.total(squares), 1e-300) / self.base)
        return float(np.mean(level + harm * np.maximum(level, 0.0)))

    def total(self, squares: Array) -> Array:
        """Squares of all blocks, shape (n,), [N²·m²]; see :func:`total`."""
        return total(squares, self._robust)

    def rms(self, squares: Array) -> Array:
        """Held-out RMS of each joint, shape (n,), [N·m]."""
        return np.asarray(np.sqrt(squares.sum(axis=0) / self._data.moving))
