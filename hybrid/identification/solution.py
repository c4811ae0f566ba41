"""The solution of the terms of an arm, with its held-out error."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.effects import Effect
from hybrid.model.dynamic_model import DynamicModel
from hybrid.regression.cross_products import CrossProducts, accumulate
from hybrid.regression.intervals import Estimate, with_uncertainty
from hybrid.regression.least_squares import WeightedSolution, residual_covariance
from hybrid.regression.problem import Problem
from hybrid.robot import Robot


@dataclass(frozen=True)
class Solution:
    """A linear problem with its solution.

    Attributes:
        products: Cross-products of the data.
        weighted: The solution on all samples, with its weights.
        theta: Solutions without each fold, shape (F, p).
        strength: Number of samples that the prior is worth.
        inertial: Physically consistent links that give these values, shape (n, 10),
            or None.
        beside: Gains that are beside these links, by their column.
        remainder: Learned remainder of the torque, or None.
        corrected: Held-out squares less a remainder, shape (B, n), [N²·m²], or None.
    """

    products: CrossProducts
    weighted: WeightedSolution
    theta: Array
    strength: float = 0.0
    inertial: Array | None = None
    beside: Mapping[int, float] = field(default_factory=dict)
    remainder: ArmRemainder | None = None
    corrected: Array | None = None

    @property
    def problem(self) -> Problem:
        """The unknowns."""
        return self.products.problem

    @cached_property
    def squares(self) -> Array:
        """Held-out squares of each block, unfiltered, shape (B, n), [N²·m²]."""
        if self.corrected is not None:
            return self.corrected
        return self.products.held_out_squares(self.theta)

    @cached_property
    def estimate(self) -> Estimate:
        """The values with their uncertainty.

        Folds are different motions or logs. If the solutions without each fold scatter
        more than the blocks predict, all variances are increased by that ratio. Gains
        that the data have set to zero are unknowns here, so that the covariance
        includes the uncertainty of that choice.
        """
        whole, products = self.problem.complete(), self.products
        same = whole is self.problem
        complete = products if same else accumulate(whole, products.data)
        found = with_uncertainty(products, self.weighted, complete)
        folds = len(self.theta)
        scatter = (folds - 1) * self.theta.var(axis=0)
        known = (scatter > 0) & (found.std > 0)
        if not known.any():
            return found
        ratio = max(1.0, float(np.mean(scatter[known] / found.std[known] ** 2)))
        return replace(found, covariance=ratio * found.covariance)

    @cached_property
    def sigma(self) -> Array:
        """Residual covariance across joints, shape (n, n), [N²·m²]."""
        return residual_covariance(self.products, self.weighted.theta)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Effects with their values; always the same objects."""
        return self.problem.fitted(self.weighted.theta)[1]

    def model(self, robot: Robot, *, sure: bool = True) -> DynamicModel:
        """The terms as a model; gains have standard deviations if it is ``sure``."""
        theta, mapping = self.weighted.theta, self.problem.base.mapping
        theta = theta - mapping[:, [*self.beside]] @ [*self.beside.values()]
        base, fitted = self.problem.fitted(theta)
        effects = list(fitted)
        for column, value in self.beside.items():
            e, g = self.problem.columns[column - 10 * robot.size]
            effects[e] = effects[e].at({effects[e].gains[g].name: value})
        data = self.products.data
        std: list[dict[str, float]] = [{} for _ in effects]
        for unknown, e, g in self.problem.gains if sure else ():
            std[e][effects[e].gains[g].name] = float(self.estimate.std[unknown])
        return DynamicModel(
            robot,
            base,
            tuple(e.at({}, s) for e, s in zip(effects, std, strict=True)),
            self.remainder,
            data.cutoff,
            data.standing,
            data.visited,
            self.inertial,
            band=data.band,
        )


def with_zero_gains(effects: Sequence[Effect]) -> list[Effect]:
    """Effects with gains of zero, except those found by successive linearisation."""
    return [
        e if e.changes_signals else e.at({g.name: 0.0 for g in e.gains})
        for e in effects
    ]
