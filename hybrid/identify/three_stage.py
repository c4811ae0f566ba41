"""Identification in three stages, iterated: rigid body, friction, learned remainder.

Every stage must lower the error on samples that it was not fitted on; one that does not
is left out, for the joint concerned or altogether, with a warning.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning, IdentificationError
from hybrid.identify.cross_products import CrossProducts
from hybrid.identify.data import Data, helps, prepare, visited
from hybrid.identify.friction import fit_friction
from hybrid.identify.least_squares import (
    ESTIMATORS,
    CrossValidation,
    Estimate,
    Estimator,
    cross_validate,
    solve,
)
from hybrid.identify.model import DynamicModel
from hybrid.identify.problem import Problem, build_problem
from hybrid.identify.remainder import fit_remainder
from hybrid.identify.ripple import find_ripples
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion

Stage = Literal["rigid", "friction", "ripple", "remainder"]
STAGES: tuple[Stage, ...] = ("rigid", "friction", "ripple", "remainder")

_FRICTION = (Coulomb, Viscous, ThresholdFriction, LoadFriction)
_WORTH = 0.02  # least relative fall of squares for a joint's term to stay
_MOST_ROUNDS = 4
_SETTLED = 0.005  # relative change of the held-out error that ends the iteration
_MOST_RIPPLE_ROUNDS = 3


@dataclass(frozen=True)
class Fit:
    """A model and how far to trust it.

    Attributes:
        model: The identified model.
        names: Unknowns of the linear part, in full, length p.
        labels: Their short names, length p.
        units: Their units, length p.
        estimate: Values, covariance and residual covariance of the linear part.
        held_out: RMS of each joint on samples that no stage was fitted on, by stage,
            each of shape (n,), [N·m].
        converged: False if the iteration limit came first, in any loop.
        unidentifiable: What no motion, or not these recordings, can tell, in words.
        left_out: Stages that did not help, in words.
        rounds: How often the three stages were gone through.
    """

    model: DynamicModel
    names: tuple[str, ...]
    labels: tuple[str, ...]
    units: tuple[str, ...]
    estimate: Estimate
    held_out: Mapping[str, Array]
    converged: bool
    unidentifiable: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    rounds: int = 1
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def covariance(self) -> Array:
        """Covariance of the unknowns, shape (p, p)."""
        return self.estimate.covariance

    @property
    def sigma(self) -> Array:
        """Residual covariance across joints, shape (n, n), [N²·m²]."""
        return self.estimate.sigma

    @property
    def condition(self) -> float:
        """Condition number of the whitened, column-scaled columns."""
        return self.estimate.condition


@dataclass(frozen=True)
class _Solution:
    """Physical terms solved on all samples, and scored fold by fold."""

    problem: Problem
    products: CrossProducts
    estimate: Estimate
    cross: CrossValidation

    @property
    def error(self) -> Array:
        """RMS of each joint on folds that were left out, shape (n,), [N·m]."""
        return self.cross.rms

    def model(self, robot: Robot, data: Data) -> DynamicModel:
        base, effects = self.problem.fitted(self.estimate.theta)
        return DynamicModel(
            robot, base, effects, None, data.cutoff, data.standing, visited(data)
        )


def identify(
    robot: Robot,
    recordings: Sequence[Recording | Motion],
    *,
    estimator: Estimator = "irls",
    stages: Sequence[Stage] = STAGES,
    effects: Sequence[Effect] = (),
    cutoff: float | None = None,
    robust: bool = False,
    seed: int = 0,
) -> Fit:
    """Identify the drive torque of an arm from logs of its joints.

    Args:
        robot: The arm; its inertias serve only as a first idea of the load.
        recordings: Logs, or motions made from them whose masks leave samples out.
        estimator: ``ls``, ``wls`` or ``irls`` with the full covariance across joints.
        stages: Which of the stages to run; ``rigid`` always does.
        effects: More effects whose gains are to be found along with the rigid body.
        cutoff: Cut-off of columns and torque, [Hz]; from the spectrum if not given.
        robust: Weigh down stretches that do not fit (contacts, glitches).
        seed: Seed of the mixtures' starts.

    Returns:
        The model with covariance, held-out errors and what could not be told.

    Raises:
        IdentificationError: Unknown estimator or stage, or too little data.
        RecordingError: A recording does not fit the arm.

    Warns:
        HybridWarning: A stage was left out, an iteration did not converge, or the
            motion leaves parameters open.
    """
    _check_choices(estimator, stages)
    data = prepare(robot, recordings, cutoff)
    search = _Search(robot, data, estimator, tuple(effects), robust, seed)
    held_out = search.plain()
    if "friction" in stages:
        search.bend()
        held_out["+ friction"] = search.best.error
    if "ripple" in stages:
        search.ripple()
        held_out["+ ripple"] = search.best.error
    if "remainder" in stages:
        search.learn("friction" in stages)
        held_out["+ remainder"] = search.error
    return search.fit(held_out)


class _Search:
    """The state of one identification: the best terms so far and their error."""

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
        self.simpler: dict[Estimator, _Solution] = {}
        self.stages: dict[str, _Solution] = {}
        self.remainder: ArmRemainder | None = None
        self.left_out: list[str] = []
        self.rounds, self.settled = 1, True

    def plain(self) -> dict[str, Array]:
        """Stage one with linear friction, by all three estimators."""
        joints = range(self.robot.size)
        classes = (Armature, TorqueOffset, Coulomb, Viscous)
        linear = [cls((j,)) for cls in classes for j in joints]
        problem = build_problem(self.robot.chain, (*linear, *self.extra))
        products = self.data.products(problem)
        for name in ESTIMATORS:
            estimate = solve(products, name, robust=self.robust)
            cross = cross_validate(products, estimate)
            self.simpler[name] = _Solution(problem, products, estimate, cross)
        self.best = self.simpler[self.estimator]
        self.error = self.best.error
        self.scale = np.maximum(self.simpler["ls"].error, 1e-12)
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
            rest = self.data.rest_of_folds(self.best.problem, self.best.cross.theta)
            joints = range(self.robot.size)
            ripples = [r for j in joints for r in find_ripples(self.data, rest, j)]
            if not ripples:
                break
            model = self.best.model(self.robot, self.data)
            found = self._solve(self.best, [*model.effects, *ripples], None)
            if self._mean(found.error) >= self._mean(self.error):
                break
            self.best, self.error = found, found.error
        if self.best is not before:
            self.stages["+ friction"] = before

    def learn(self, bend: bool) -> None:
        """Stage three, and the others again around it, until the error settles."""
        physical = self.best
        for self.rounds in range(1, _MOST_ROUNDS + 1):
            rest = self.data.rest_of_folds(physical.problem, physical.cross.theta)
            learned = fit_remainder(rest, among=self.remainder, seed=self.seed)
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
                model = physical.model(self.robot, self.data)
                physical = self._solve(physical, model.effects, known)
        else:
            self.settled = False
        if self.remainder is None:
            self._leave_out("remainder: no regression lowers the error")

    def _with_friction(
        self, start: _Solution, known: Sequence[Array] | None
    ) -> _Solution:
        """Friction of each joint anew, then all physical terms together."""
        data, model = self.data, start.model(self.robot, self.data)
        others = [e for e in model.effects if not self._is_friction(e)]
        bodies = [model.body(m) for m in data.motions]
        rest = []
        for motion, body in zip(data.motions, bodies, strict=True):
            left = motion.tau - body.load
            for effect in others:
                left[:, effect.joints] -= effect.torque(motion, body)
            rest.append(left)
        found: list[Effect] = []
        for j in range(self.robot.size):
            offset = [e for e in others if e.id == TorqueOffset.id and e.joints == (j,)]
            level = sum(e.values["level"] for e in offset)
            terms = partial(
                fit_friction,
                j,
                data.motions,
                load=[body.load[:, j] for body in bodies],
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
        self, start: _Solution, new: _Solution, known: Sequence[Array] | None
    ) -> _Solution:
        """Give joints whose error did not fall on every fold their friction back."""
        before, after = start.cross.squares, new.cross.squares
        worse = np.array(
            [not helps(x, y, _WORTH) for x, y in zip(before.T, after.T, strict=True)]
        )
        if not worse.any():
            return new
        if worse.all():
            return start
        now, then = (s.model(self.robot, self.data).effects for s in (new, start))
        laws = (*_FRICTION, TorqueOffset)
        mine = [e for e in self.extra if isinstance(e, laws)]

        def keeps(effect: Effect, former: bool) -> bool:
            if not isinstance(effect, laws) or _same_place(effect, mine):
                return not former
            return bool(worse[effect.joints[0]]) is former

        kept = [e for e in now if keeps(e, False)] + [e for e in then if keeps(e, True)]
        mixed = self._solve(start, kept, known)
        return min(new, mixed, key=lambda s: self._mean(s.error))

    def _is_friction(self, effect: Effect) -> bool:
        """Whether stage two may replace an effect; the user's own ones stay."""
        return isinstance(effect, _FRICTION) and not _same_place(effect, self.extra)

    def _solve(
        self,
        start: _Solution,
        effects: Sequence[Effect],
        known: Sequence[Array] | None,
    ) -> _Solution:
        # What stage two left at zero stays there: its opposites would be collinear.
        without = [
            (k, g.name)
            for k, e in enumerate(effects)
            for g in e.gains
            if isinstance(e, ThresholdFriction) and e.values[g.name] == 0.0
        ]
        zeroed = [
            e if e.reports else e.at({g.name: 0.0 for g in e.gains}) for e in effects
        ]
        inertial = start.problem.rigid_inertial(start.estimate.theta)
        problem = build_problem(
            self.robot.chain, zeroed, inertial=inertial, without=without
        )
        products = self.data.products(problem, known)
        estimate = solve(products, self.estimator, bounded=True, robust=self.robust)
        cross = cross_validate(products, estimate, bounded=True)
        return _Solution(problem, products, estimate, cross)

    def _mean(self, error: Array) -> float:
        """Mean over joints, each against plain least squares."""
        return float(np.mean(error / self.scale))

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        warnings.warn(
            f"left out {text} on held-out samples", HybridWarning, stacklevel=4
        )

    def fit(self, held_out: dict[str, Array]) -> Fit:
        """The chosen terms, how sure they are, and what is open."""
        problem, estimate = self.best.problem, self.best.estimate
        model = self.best.model(self.robot, self.data)
        model = replace(
            model,
            effects=_with_std(problem, estimate, model.effects),
            remainder=self.remainder,
        )
        simpler = {
            name.upper(): solution.model(self.robot, self.data)
            for name, solution in self.simpler.items()
        }
        for name, solution in self.stages.items():
            simpler[name] = solution.model(self.robot, self.data)
        if self.remainder is not None:
            last = "+ ripple" if self.stages else "+ friction"
            simpler[last] = model.without_remainder()
        converged = estimate.converged and self.settled
        if not converged:
            warnings.warn(
                "the iteration did not settle; see Fit.converged",
                HybridWarning,
                stacklevel=3,
            )
        return Fit(
            model=replace(model, simpler=simpler),
            names=problem.base.names,
            labels=problem.base.kept_labels,
            units=tuple(problem.base.units[k] for k in problem.base.kept),
            estimate=estimate,
            held_out=held_out,
            converged=converged,
            unidentifiable=_unidentifiable(problem, estimate),
            left_out=tuple(self.left_out),
            rounds=self.rounds,
        )


def _same_place(effect: Effect, others: Sequence[Effect]) -> bool:
    """Whether an effect of the same kind is at the same joints."""
    return any(type(effect) is type(e) and effect.joints == e.joints for e in others)


def _check_choices(estimator: str, stages: Sequence[str]) -> None:
    if estimator not in ESTIMATORS:
        raise IdentificationError(
            f"no estimator {estimator!r}; valid are {', '.join(ESTIMATORS)}"
        )
    unknown = [s for s in stages if s not in STAGES]
    if unknown:
        raise IdentificationError(
            f"no stage {', '.join(unknown)}; valid are {', '.join(STAGES)}"
        )


def _with_std(
    problem: Problem, estimate: Estimate, effects: Sequence[Effect]
) -> tuple[Effect, ...]:
    """Effects with the standard deviations of their gains."""
    std: list[dict[str, float]] = [{} for _ in effects]
    for unknown, e, g in problem.gains:
        std[e][problem.effects[e].gains[g].name] = float(estimate.std[unknown])
    return tuple(e.at({}, s) for e, s in zip(effects, std, strict=True))


def _unidentifiable(problem: Problem, estimate: Estimate) -> tuple[str, ...]:
    """What no motion could tell apart, then what these recordings leave open."""
    base, rigid = problem.base, 10 * problem.chain.size
    found = []
    for label, joined in base.dropped.items():
        if base.labels.index(label) >= rigid:
            found.append(
                f"{label} cannot be told from {joined}: only their combination is known"
                if joined
                else f"{label} moves no torque"
            )
    labels = base.kept_labels
    found += [
        f"{labels[k]} is not determined by these recordings"
        for k in estimate.undetermined
    ]
    low, high = estimate.interval()
    for k in range(base.size):
        if k not in estimate.undetermined and base.kept[k] < rigid and low[k] < 0 < high[k]:
            found.append(f"{labels[k]} cannot be told from zero")
    return tuple(found)
