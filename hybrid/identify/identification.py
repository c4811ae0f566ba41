"""The state of one identification: the best terms so far, and what each stage does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.identify.consistency import physically_consistent
from hybrid.identify.data import Data, Rest, helps
from hybrid.identify.fit import Fit, poor_excitation, unidentifiable
from hybrid.identify.friction import fit_friction
from hybrid.identify.least_squares import (
    ESTIMATORS,
    Estimator,
    cross_validate,
    solve,
)
from hybrid.identify.model import DynamicModel
from hybrid.identify.problem import Problem, build_problem
from hybrid.identify.remainder import Learned, fit_remainder
from hybrid.identify.ripple import find_ripples
from hybrid.identify.solution import Solution, to_be_found
from hybrid.robot import Robot
from hybrid.robot.chain import Array

_FRICTION = (Coulomb, Viscous, ThresholdFriction, LoadFriction)
_WORTH = 0.02  # least relative fall of squares for a joint's term to stay
_MOST_ROUNDS = 4
_SETTLED = 0.005  # relative change of the held-out error that ends the iteration
_MOST_RIPPLE_ROUNDS = 3
_MOST_LINEARISATIONS = 8
# Largest share of the rated torque that a learned remainder may ever give: it is a
# correction; should it go wrong, the arm's own brakes and limits must master it.
MOST_LEARNED = 0.3
_COSTLY = 0.01  # relative rise of the held-out error that is warned of


class Identification:
    """The best terms so far and their error; every stage may improve them.

    Args:
        robot: The arm.
        data: Motions with folds.
        estimator: How joints are weighed.
        extra: Effects of the user.
        robust: Weigh down stretches that do not fit.
        seed: Seed of the mixtures' starts.
    """

    def __init__(
        self,
        robot: Robot,
        data: Data,
        estimator: Estimator,
        extra: tuple[Effect, ...],
        robust: bool,
        seed: int,
    ) -> None:
        self.robot, self.data, self.estimator = robot, data, estimator
        self.extra, self.robust, self.seed = extra, robust, seed
        self.simpler: dict[Estimator, Solution] = {}
        self.stages: dict[str, DynamicModel] = {}
        self.remainder: ArmRemainder | None = None
        self.left_out: list[str] = []
        self.warnings: list[str] = []
        self.rounds, self.settled = 1, True

    def plain(self) -> dict[str, Array]:
        """Stage one with linear friction, by all three estimators."""
        joints = range(self.robot.size)
        classes = (Armature, TorqueOffset, Coulomb, Viscous)
        linear = [cls((j,)) for cls in classes for j in joints]
        problem = build_problem(self.robot.chain, (*linear, *self.extra))
        if any(e.reports or e.observes for e in self.extra):
            problem = self._linearised(problem)
        products = self.data.products(problem)
        for name in ESTIMATORS:
            estimate = solve(products, name, robust=self.robust)
            cross = cross_validate(products, estimate)
            self.simpler[name] = Solution(problem, products, estimate, cross)
        self.best = self.simpler[self.estimator]
        self.error = self.best.error
        self.scale = np.maximum(self.simpler["ls"].error, 1e-12)
        poor = poor_excitation(products, self.best.estimate)
        if poor:
            self.warnings.append(poor)
        return {name.upper(): s.error for name, s in self.simpler.items()}

    def bend(self) -> None:
        """Stage two, and stage one again with its law, until the error settles."""
        for _ in range(_MOST_ROUNDS):
            found = self._with_friction(self.best, None)
            gain = self._mean(self.error) - self._mean(found.error)
            if gain > 0:
                self.best, self.error = found, found.error
            if gain <= _SETTLED * self._mean(self.error):
                break
        if self.best is self.simpler[self.estimator]:
            self._leave_out("friction: the threshold law does not lower the error")

    def ripple(self) -> None:
        """Stage two, second part: torque that repeats with position."""
        before = self.best
        for _ in range(_MOST_RIPPLE_ROUNDS):
            joints = range(self.robot.size)
            ripples = [r for j in joints for r in find_ripples(self.data, self.best, j)]
            if not ripples:
                break
            effects = self.best.effects
            found = self._solve(self.best, [*effects, *ripples], None)
            if self._mean(found.error) >= self._mean(self.error):
                break
            self.best, self.error = found, found.error
        if self.best is not before:
            self._keep(self._model(before))

    def learn(self, *, bend: bool) -> None:
        """Stage three, and the others again around it, until the error settles.

        Args:
            bend: Whether stage two is one of the others.
        """
        physical = self.best
        for self.rounds in range(1, _MOST_ROUNDS + 1):
            rest = self.data.rest_of_folds(physical.problem, physical.cross.theta)
            learned = self._learned(rest)
            if not learned.remainder.parts:
                break
            gain = self._mean(self.error) - self._mean(learned.rms)
            if gain > 0:
                self.best, self.error = physical, learned.rms
                self.remainder = learned.remainder
            if gain <= _SETTLED * self._mean(self.error):
                break
            known = self.data.split(learned.cross)
            if bend:
                physical = self._with_friction(physical, known)
            else:
                physical = self._solve(physical, physical.effects, known)
        else:
            self.settled = False
        if self.remainder is None:
            self._leave_out("remainder: no regression lowers the error")
        else:
            self._keep(self._model(self.best))

    def _learned(self, rest: Rest) -> Learned:
        bound = MOST_LEARNED * self.robot.tau_max
        return fit_remainder(rest, among=self.remainder, bound=bound, seed=self.seed)

    def constrain(self) -> None:
        """Links that could be built; what was learned is learned anew around them."""
        free, before = self.best, self.error
        self._keep(self._model(free, self.remainder))

        def optimum(A: Array, b: Array) -> Array:
            return physically_consistent(free.problem, A, b).theta

        sums = np.tensordot(free.estimate.share, free.products.blocks, axes=1)
        found = physically_consistent(
            free.problem, *free.products.normal(free.estimate.weight, sums)
        )
        estimate = replace(free.estimate, theta=found.theta)
        cross = cross_validate(free.products, estimate, optimum=optimum)
        self.settled &= found.converged
        self.best = replace(
            free, estimate=estimate, cross=cross, inertial=found.inertial
        )
        self.error = self.best.error
        if self.remainder is not None:
            rest = self.data.rest_of_folds(free.problem, cross.theta)
            learned = self._learned(rest)
            self.remainder = learned.remainder if learned.remainder.parts else None
            self.error = learned.rms
        cost = self._mean(self.error) / self._mean(before) - 1.0
        if cost > _COSTLY:
            self.warnings.append(
                f"physically consistent links raise the held-out error by {cost:.1%}; "
                "the data want links that cannot be built"
            )

    def fit(self, held_out: dict[str, Array]) -> Fit:
        """The chosen terms, how sure they are, and what is open."""
        problem, estimate = self.best.problem, self.best.estimate
        model = self._model(self.best, self.remainder)
        simpler = {name.upper(): self._model(s) for name, s in self.simpler.items()}
        converged = estimate.converged and self.settled
        if not converged:
            self.warnings.append("the iteration did not settle; see Fit.converged")
        return Fit(
            model=replace(model, simpler=simpler | self.stages),
            names=problem.base.names,
            labels=problem.base.kept_labels,
            units=tuple(problem.base.units[k] for k in problem.base.kept),
            estimate=estimate,
            held_out=held_out,
            condition=self.simpler[self.estimator].estimate.condition,
            converged=converged,
            unidentifiable=unidentifiable(problem, estimate),
            left_out=tuple(self.left_out),
            warnings=tuple(self.warnings),
            rounds=self.rounds,
        )

    def _linearised(self, problem: Problem) -> Problem:
        """The same problem around the values that signal-changing effects settle at."""
        for _ in range(_MOST_LINEARISATIONS):
            theta = solve(self.data.products(problem), self.estimator).theta
            effects = to_be_found(problem.fitted(theta)[1])
            before = [x for e in problem.effects for x in e.gain_values]
            problem = build_problem(
                problem.chain, effects, inertial=problem.rigid_inertial(theta)
            )
            after = [x for e in problem.effects for x in e.gain_values]
            if np.allclose(before, after, rtol=1e-3):
                break
        else:
            self.settled = False
        return problem

    def _with_friction(
        self, start: Solution, known: Sequence[Array] | None
    ) -> Solution:
        """Friction of each joint anew, then all physical terms together."""
        data, model = self.data, self._model(start)
        others = [e for e in start.effects if not self._is_friction(e)]
        frictionless = replace(model, effects=tuple(others))
        rest = [m.tau - frictionless.predict(m) for m in data.motions]
        loads = [model.body(m).load for m in data.motions]
        found: list[Effect] = []
        for j in range(self.robot.size):
            offset = [e for e in others if e.id == TorqueOffset.id and e.joints == (j,)]
            level = sum(e.values["level"] for e in offset)
            terms = partial(
                fit_friction,
                j,
                data.motions,
                load=[load[:, j] for load in loads],
                known=None if known is None else [x[:, j] for x in known],
                cutoff=data.cutoff,
                standing=data.standing[j],
                folds=data.folds,
            )
            # Two levels, one a direction, take an offset in unless it exceeds them.
            friction, squares = terms([x[:, j] + level for x in rest])
            kept, squares_kept = terms([x[:, j] for x in rest])
            if offset and helps(squares, squares_kept, _WORTH):
                friction = kept
            else:
                others = [e for e in others if e not in offset]
            found += friction
        new = self._solve(start, [*others, *found], known)
        return self._without_losses(start, new, known)

    def _without_losses(
        self, start: Solution, new: Solution, known: Sequence[Array] | None
    ) -> Solution:
        """Give joints whose error did not fall on every fold their friction back."""
        before, after = start.cross.squares, new.cross.squares
        worse = np.array(
            [not helps(x, y, _WORTH) for x, y in zip(before.T, after.T, strict=True)]
        )
        if not worse.any():
            return new
        if worse.all():
            return start
        now, then = (s.effects for s in (new, start))
        laws = (*_FRICTION, TorqueOffset)
        mine = [e for e in self.extra if isinstance(e, laws)]

        def keeps(effect: Effect, former: bool) -> bool:
            if not isinstance(effect, laws) or _same_place(effect, mine):
                return not former
            return bool(worse[effect.joints[0]]) is former

        kept = [e for e in now if keeps(e, False)] + [e for e in then if keeps(e, True)]
        mixed = self._solve(start, kept, known)
        return min(new, mixed, key=lambda s: self._mean(s.error))

    def _solve(
        self,
        start: Solution,
        effects: Sequence[Effect],
        known: Sequence[Array] | None,
    ) -> Solution:
        # What stage two left at zero stays there: its opposites would be collinear.
        without = [
            (k, g.name)
            for k, e in enumerate(effects)
            for g in e.gains
            if isinstance(e, ThresholdFriction) and e.values[g.name] == 0.0
        ]
        problem = build_problem(
            self.robot.chain,
            to_be_found(effects),
            inertial=start.problem.rigid_inertial(start.estimate.theta),
            without=without,
        )
        products = self.data.products(problem, known)
        estimate = solve(products, self.estimator, bounded=True, robust=self.robust)
        cross = cross_validate(products, estimate, bounded=True)
        return Solution(problem, products, estimate, cross)

    def _model(
        self, solution: Solution, remainder: ArmRemainder | None = None
    ) -> DynamicModel:
        return solution.model(self.robot, self.data, remainder)

    def _is_friction(self, effect: Effect) -> bool:
        """Whether stage two may replace an effect; the user's own ones stay."""
        return isinstance(effect, _FRICTION) and not _same_place(effect, self.extra)

    def _mean(self, error: Array) -> float:
        """Mean over joints, each against plain least squares."""
        return float(np.mean(error / self.scale))

    def _keep(self, model: DynamicModel) -> None:
        """Keep the model of a stage that another one follows, for comparison."""
        if model.stage != "rigid":  # that one is among the plain estimators
            self.stages[model.stage] = model

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        self.warnings.append(f"left out {text} on held-out samples")


def _same_place(effect: Effect, others: Sequence[Effect]) -> bool:
    """Whether an effect of the same kind is at the same joints."""
    return any(type(effect) is type(e) and effect.joints == e.joints for e in others)
