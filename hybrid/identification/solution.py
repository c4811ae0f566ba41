"""Physical terms solved on all samples, and scored fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.effects import Effect
from hybrid.identification.data import Data, visited
from hybrid.model.dynamic_model import DynamicModel
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.intervals import Estimate, estimated
from hybrid.regression.least_squares import Settled, residual_covariance
from hybrid.regression.prior import Prior
from hybrid.regression.problem import Problem
from hybrid.robot import Robot


@dataclass(frozen=True)
class Solution:
    """A linear problem with its solution.

    Attributes:
        data: The motions.
        products: Their cross-products.
        settled: Their values and weights on all samples.
        prior: What was known beforehand, or None.
        bounded: Whether gains kept at their physical side.
        theta: Their values without each fold, shape (F, p).
        squares: Held-out squares of each block, unfiltered, shape (B, n), [N²·m²].
        inertial: Physically consistent links that give these values, shape (n, 10),
            or None.
    """

    data: Data
    products: CrossProducts
    settled: Settled
    prior: Prior | None
    bounded: bool
    theta: Array
    squares: Array
    inertial: Array | None = None

    @property
    def problem(self) -> Problem:
        """The unknowns."""
        return self.products.problem

    @cached_property
    def estimate(self) -> Estimate:
        """The values and how sure they are, over blocks and over whole folds.

        Folds are other motions, or other logs: where they scatter more than the blocks
        within them let expect, all variances are larger by as much. A gain that was
        left at zero might have been taken on another log: it is an unknown here.
        """
        whole = self.problem.complete()
        among = self.products if whole is self.problem else self.data.products(whole)
        found = estimated(self.products, self.settled, prior=self.prior, among=among)
        folds = len(self.theta)
        scatter = (folds - 1) * self.theta.var(axis=0)
        known = (scatter > 0) & (found.std > 0)
        if not known.any():
            return found
        more = max(1.0, float(np.mean(scatter[known] / found.std[known] ** 2)))
        return replace(found, covariance=more * found.covariance)

    @cached_property
    def sigma(self) -> Array:
        """Residual covariance across joints, shape (n, n), [N²·m²]."""
        return residual_covariance(self.products, self.settled.theta)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """Effects with their values, the same objects whenever they are asked for."""
        return self.problem.fitted(self.settled.theta)[1]

    def model(
        self,
        robot: Robot,
        remainder: ArmRemainder | None = None,
        *,
        sure: bool = True,
    ) -> DynamicModel:
        """The terms as a model, its gains with their standard deviations.

        Args:
            robot: The arm.
            remainder: What was learned of the rest.
            sure: Whether to say how sure the gains are.
        """
        base, effects = self.problem.fitted(self.settled.theta)
        std: list[dict[str, float]] = [{} for _ in effects]
        for unknown, e, g in self.problem.gains if sure else ():
            std[e][effects[e].gains[g].name] = float(self.estimate.std[unknown])
        return DynamicModel(
            robot,
            base,
            tuple(e.at({}, s) for e, s in zip(effects, std, strict=True)),
            remainder,
            self.data.cutoff,
            self.data.standing,
            visited(self.data.motions),
            self.inertial,
        )


def to_be_found(effects: Sequence[Effect]) -> list[Effect]:
    """Effects without their gains, but for those found by successive linearisation."""
    return [
        e if e.reports or e.observes else e.at({g.name: 0.0 for g in e.gains})
        for e in effects
    ]
