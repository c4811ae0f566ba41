"""Physical terms solved on all samples, and scored fold by fold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.effects import Effect
from hybrid.identify.cross_products import CrossProducts
from hybrid.identify.data import Data, visited
from hybrid.identify.least_squares import CrossValidation, Estimate
from hybrid.identify.model import DynamicModel
from hybrid.identify.problem import Problem
from hybrid.robot import Robot
from hybrid.robot.chain import Array


@dataclass(frozen=True)
class Solution:
    """A linear problem with its solution.

    Attributes:
        problem: The unknowns.
        products: The data.
        estimate: Their values on all samples.
        cross: Their values and errors fold by fold.
        inertial: Physically consistent links that give these values, shape (n, 10),
            or None.
    """

    problem: Problem
    products: CrossProducts
    estimate: Estimate
    cross: CrossValidation
    inertial: Array | None = None

    @property
    def error(self) -> Array:
        """RMS of each joint on folds that were left out, shape (n,), [N·m]."""
        return self.cross.rms

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Effects with their values."""
        return self.problem.fitted(self.estimate.theta)[1]

    def model(
        self, robot: Robot, data: Data, remainder: ArmRemainder | None = None
    ) -> DynamicModel:
        """The terms as a model, its gains with their standard deviations.

        Args:
            robot: The arm.
            data: What was fitted.
            remainder: What was learned of the rest.
        """
        base, effects = self.problem.fitted(self.estimate.theta)
        std: list[dict[str, float]] = [{} for _ in effects]
        for unknown, e, g in self.problem.gains:
            std[e][effects[e].gains[g].name] = float(self.estimate.std[unknown])
        return DynamicModel(
            robot,
            base,
            tuple(e.at({}, s) for e, s in zip(effects, std, strict=True)),
            remainder,
            data.cutoff,
            data.standing,
            visited(data),
            self.inertial,
        )


def to_be_found(effects: Sequence[Effect]) -> list[Effect]:
    """Effects without their gains, but for those found by successive linearisation."""
    return [
        e if e.reports or e.observes else e.at({g.name: 0.0 for g in e.gains})
        for e in effects
    ]
