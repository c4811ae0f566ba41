"""The state of one identification: the best terms so far, and what each rung does.

The ladder: least squares, weighted by the variance of each joint, by the full
covariance across joints, with the robot file as a prior; then friction, ripple and a
learned remainder. A rung is taken for each joint on which it lowers the held-out error
of the torque that the model predicts, by one gate; see ``gate.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import RigidBody
from hybrid.effects import Effect
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.data import FOLDS, Data
from hybrid.identification.fit import Fit, poor_excitation, unidentifiable
from hybrid.identification.friction import fit_friction
from hybrid.identification.gate import lowers
from hybrid.identification.preparation import linear_effects, scored
from hybrid.identification.remainder import Learned, fit_remainder
from hybrid.identification.ripple import JUDGED, Waves, find_ripples, in_band
from hybrid.identification.solution import Solution
from hybrid.identification.solver import Solver
from hybrid.model.dynamic_model import DynamicModel
from hybrid.regression.least_squares import Estimator, without_folds
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion

_FRICTION = (
    Coulomb, Viscous, NonlinearViscous, ThresholdFriction, LoadFriction, TorqueOffset,
)  # fmt: skip
_MOST_ROUNDS = 4
_SETTLED = 0.005  # relative change of the held-out error that ends the iteration
# Largest share of the rated torque that a learned remainder may ever give: it is a
# correction; should it go wrong, the arm's own brakes and limits must master it.
MOST_LEARNED = 0.3
_WORSE = 0.05  # relative rise of the error above that of the file that is refused
_COSTLY = 0.01  # relative rise of the held-out error that is warned of


class Identification:
    """The best terms so far and their error; every rung may improve them.

    Args:
        robot: The arm.
        data: Motions with folds.
        estimator: How joints are weighed, at the most.
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
        self.extra, self.seed = extra, seed
        self.solver = Solver(robot, data, estimator, robust)
        self.simpler: dict[Estimator, Solution] = {}
        self.stages: dict[str, DynamicModel] = {}
        self.remainder: ArmRemainder | None = None
        self.left_out: list[str] = []
        self.warnings: list[str] = []
        self.rounds, self.settled = 1, True

    best: Solution
    squares: Array

    def plain(self) -> dict[str, Array]:
        """Rigid body with linear friction: by three estimators, then with the prior."""
        linear = linear_effects(self.robot)
        problem = build_problem(self.robot.chain, (*linear, *self.extra))
        if any(e.reports or e.observes for e in self.extra):
            problem, self.settled = self.solver.linearised(problem)
        self.simpler = self.solver.plain(problem)
        self._take(self.solver.best(problem))
        last = self.simpler[self.estimator]
        poor = poor_excitation(last.products, last.estimate)
        if poor:
            self.warnings.append(poor)
        found = {x.upper(): s.squares for x, s in self.simpler.items()}
        found["rigid"] = self.squares
        return {name: self.solver.rms(squares) for name, squares in found.items()}

    @property
    def error(self) -> Array:
        """Held-out RMS of each joint, shape (n,), [N·m]."""
        return self.solver.rms(self.squares)

    def bend(self) -> None:
        """Stage two, and stage one again with its law, until the error settles."""
        before = self.best
        for _ in range(_MOST_ROUNDS):
            offer = self._friction(self.best)
            found = self._climb(self.best, [offer])
            gain = self.solver.cost(self.best.squares) - self.solver.cost(found.squares)
            self._take(found)
            if gain <= _SETTLED:
                break
        if self.best is before:
            self._leave_out("friction: the threshold law does not lower the error")

    def ripple(self) -> None:
        """Stage two, second part: torque that repeats with position."""
        before, waves = self.best, Waves()
        for _ in range(_MOST_ROUNDS):
            new = find_ripples(self.data, self.best, waves)
            # At every speed that was seen, or else only where the fit saw it.
            offers = [
                {
                    j: [*self._at(self.best, j), *map(where, ripples)]
                    for j, ripples in new.items()
                }
                for where in (lambda x: x, partial(in_band, cutoff=self.data.cutoff))
            ]
            found = self._climb(self.best, offers, tried=JUDGED)
            if found is self.best:
                break
            self._take(found)
        if self.best is not before:
            self._keep(before)

    def learn(self) -> None:
        """Stage three, and the physical terms again around it, until it settles."""
        physical = self.best
        for self.rounds in range(1, _MOST_ROUNDS + 1):
            learned = self._learned(physical)
            if not learned.remainder.parts:
                break
            gain = self.solver.cost(self.squares) - self.solver.cost(learned.squares)
            if gain > 0:
                self.best, self.squares = physical, learned.squares
                self.remainder = learned.remainder
            if gain <= _SETTLED:
                break
            physical = self.solver.with_effects(
                physical, physical.effects, learned.cross
            )
        else:
            self.settled = False
        if self.remainder is None:
            self._leave_out("remainder: no regression lowers the error")
        else:
            self._keep(self.best)

    def _learned(self, physical: Solution) -> Learned:
        left = self.data.left_out(physical.problem, physical.theta)
        bound = MOST_LEARNED * self.robot.tau_max
        return fit_remainder(
            self.data, left, among=self.remainder, bound=bound, seed=self.seed
        )

    def constrain(self) -> None:
        """Links that could be built; what was learned is learned anew around them."""
        free, before = self.best, self.squares
        self._keep(free, self.remainder)

        def optimum(A: Array, b: Array) -> Array:
            return physically_consistent(free.problem, A, b).theta

        products, settled = free.products, free.settled
        sums = np.tensordot(settled.share, products.blocks, axes=1)
        A, b = products.normal(settled.weight, sums)
        found = physically_consistent(free.problem, A, b)
        theta = without_folds(
            products,
            settled.weight,
            optimum=optimum,
            folds=FOLDS,
            share=settled.share,
        )
        self.settled &= found.converged
        self._take(
            replace(
                free,
                settled=replace(settled, theta=found.theta),
                theta=theta,
                squares=scored(products, theta),
                inertial=found.inertial,
            )
        )
        if self.remainder is not None:
            learned = self._learned(self.best)
            self.remainder = learned.remainder if learned.remainder.parts else None
            self.squares = learned.squares
        after = self.solver.cost(self.squares, harm=0.0)
        cost = np.exp(after - self.solver.cost(before, harm=0.0)) - 1.0
        if cost > _COSTLY:
            self.warnings.append(
                f"physically consistent links raise the held-out error by {cost:.1%}; "
                "the data want links that cannot be built"
            )

    def fit(self, held_out: dict[str, Array]) -> Fit:
        """The chosen terms, how sure they are, and what is open.

        Raises:
            IdentificationError: The robot file itself predicts the torque better.
        """
        self._refuse_harm()
        problem, estimate = self.best.problem, self.best.estimate
        model = self.best.model(self.robot, self.remainder)
        simpler = {name.upper(): self._model(s) for name, s in self.simpler.items()}
        converged = estimate.converged and self.settled
        if not converged:
            self.warnings.append("the iteration did not settle; see Fit.converged")
        return Fit(
            model=replace(
                model, simpler=simpler | self.stages, covariance=estimate.covariance
            ),
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

    def _refuse_harm(self) -> None:
        """Refuse what is worse than the file; say where plain LS is better."""
        file = self.data.squares([self._file_leaves(m) for m in self.data.motions])
        total = self.solver.total(self.squares)
        ratio = np.sqrt(total / np.maximum(self.solver.total(file), 1e-300))
        if np.log(np.maximum(ratio, 1e-300)).mean() > _WORSE:
            raise IdentificationError(
                "the model predicts unseen torque worse than the robot file does "
                f"(by {ratio.mean() - 1:.0%} on the mean of the joints); valid are "
                "logs of this arm whose columns, units and clock are right"
            )
        rise = np.sqrt(total / self.solver.base) - 1.0
        for j in np.flatnonzero(rise > _COSTLY):
            self.warnings.append(
                f"{self.robot.joints[j]}: {rise[j]:.1%} worse than plain least squares "
                "on held-out samples"
            )

    def _file_leaves(self, motion: Motion) -> Array:
        robot = self.robot
        known = robot.joint_torque(motion.q, motion.v, motion.a)
        known += RigidBody(robot.chain, motion).load
        known += robot.dry_friction(motion.v)
        return np.asarray(motion.tau - known)

    def _friction(self, start: Solution) -> dict[int, list[Effect]]:
        """The effects at each joint with its friction found anew."""
        data, model = self.data, self._model(start)
        others = [e for e in start.effects if not self._is_friction(e)]
        frictionless = replace(model, effects=tuple(others))
        rest = [m.tau - frictionless.predict(m) for m in data.motions]
        loads = [model.body(m).load for m in data.motions]
        offer = {}
        for j in range(self.robot.size):
            friction = fit_friction(
                data, j, [x[:, j] for x in rest], [x[:, j] for x in loads]
            )
            kept = [e for e in self._at(start, j) if not self._is_friction(e)]
            offer[j] = [*kept, *friction]
        return offer

    def _at(self, solution: Solution, joint: int) -> list[Effect]:
        """Effects of one joint alone that stages may replace or add to."""
        mine = [e for e in solution.effects if not _same_place(e, self.extra)]
        return [e for e in mine if e.joints == (joint,)]

    def _climb(
        self,
        start: Solution,
        offers: Sequence[Mapping[int, list[Effect]]],
        *,
        tried: int = 1,
    ) -> Solution:
        """Take at each joint the first offer of effects that passes the gate."""
        taken: dict[int, list[Effect]] = {}
        for offer in offers:
            open_ = {j: x for j, x in offer.items() if j not in taken}
            if not open_:
                continue
            found = self.solver.with_effects(
                start, self._exchanged(start, {**taken, **open_})
            )
            gains = lowers(start.squares, found.squares, tried=tried)
            taken |= {j: x for j, x in open_.items() if gains[j]}
            refused = [j for j in open_ if j not in taken]
        if not taken:
            return start
        if refused:
            found = self.solver.with_effects(start, self._exchanged(start, taken))
        return min(start, found, key=lambda x: self.solver.cost(x.squares))

    def _exchanged(
        self, start: Solution, at: Mapping[int, list[Effect]]
    ) -> list[Effect]:
        old = [e for j in at for e in self._at(start, j)]
        kept = [e for e in start.effects if not any(e is x for x in old)]
        return [*kept, *(e for effects in at.values() for e in effects)]

    def _model(
        self, solution: Solution, remainder: ArmRemainder | None = None
    ) -> DynamicModel:
        """A model to compare with, which does not say how sure its gains are."""
        return solution.model(self.robot, remainder, sure=False)

    def _is_friction(self, effect: Effect) -> bool:
        """Whether stage two may replace an effect; the user's own ones stay."""
        return isinstance(effect, _FRICTION) and not _same_place(effect, self.extra)

    def _take(self, solution: Solution) -> None:
        self.best, self.squares = solution, solution.squares

    def _keep(self, solution: Solution, remainder: ArmRemainder | None = None) -> None:
        """Keep the model of a stage that another one follows, for comparison."""
        model = self._model(solution, remainder)
        if model.stage != "rigid":  # that one is among the plain estimators
            self.stages[model.stage] = model

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        self.warnings.append(f"left out {text} on held-out samples")


def _same_place(effect: Effect, others: Sequence[Effect]) -> bool:
    """Whether an effect of the same kind is at the same joints."""
    return any(type(effect) is type(e) and effect.joints == e.joints for e in others)
