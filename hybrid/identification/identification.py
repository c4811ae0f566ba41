"""The stages of one identification, and the best terms found so far.

The stages: the rigid body with linear friction, nonlinear friction, ripple, a learned
remainder, and physically consistent links. A new term of a joint is accepted only if it
lowers the held-out error of the predicted torque; see ``gate.py``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.arrays import Array
from hybrid.compensator.arm_remainder import ArmRemainder
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import Effect
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.fit import Fit, poor_excitation, unidentifiable
from hybrid.identification.friction import fit_friction
from hybrid.identification.gate import with_accepted
from hybrid.identification.remainder import Learned, fit_remainder
from hybrid.identification.ripple import JUDGED, find_ripples, in_band
from hybrid.identification.solution import Solution
from hybrid.identification.solver import Solver
from hybrid.model.dynamic_model import DynamicModel
from hybrid.regression.cross_products import CrossProducts
from hybrid.regression.data import Data
from hybrid.regression.intervals import condition_number
from hybrid.regression.least_squares import Estimator
from hybrid.robot import Robot
from hybrid.signals import Motion

_FRICTION = (
    Coulomb, Viscous, NonlinearViscous, ThresholdFriction, LoadFriction, TorqueOffset,
)  # fmt: skip
_MOST_ROUNDS = 4
_TOLERANCE = 0.005  # relative fall of the held-out error at which iterations end
# Largest torque of a learned remainder, as a share of the rated torque. If it is ever
# wrong, the brakes and limits of the arm must be able to master it.
MOST_LEARNED = 0.3
_WORSE = 0.05  # relative rise of the error above that of the file that is refused
_COSTLY = 0.01  # relative rise of the held-out error that gives a warning


class Identification:
    """The best terms found so far and their held-out error."""

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
    condition: float

    def rigid_stage(self, products: CrossProducts) -> dict[str, Array]:
        """Fit the rigid body with linear friction, whose cross-products are given.

        Returns:
            Held-out RMS of each joint by estimator, and of the best one with the
            prior, shape (n,) each, [N·m].
        """
        if any(e.changes_signals for e in self.extra):
            products, self.settled = self.solver.linearised(products)
        self.simpler = self.solver.plain(products)
        self._adopt(self.solver.best(products))
        self._record_stage(self.best)
        last = self.simpler[self.estimator]
        A, _ = products.normal(last.weighted.weight)
        self.condition = condition_number(A)
        poor = poor_excitation(products.problem, A)
        if poor:
            self.warnings.append(poor)
        found = {x.upper(): s.squares for x, s in self.simpler.items()}
        found["rigid"] = self.squares
        return {name: self.solver.rms(squares) for name, squares in found.items()}

    @property
    def error(self) -> Array:
        """Held-out RMS of each joint, shape (n,), [N·m]."""
        return self.solver.rms(self.squares)

    def friction_stage(self) -> None:
        """Fit nonlinear friction, then all terms again, until the error settles."""
        before = self.best
        for _ in range(_MOST_ROUNDS):
            candidates = self._friction_candidates(self.best)
            found = self._accepted(self.best, [candidates])
            gain = self.solver.cost(self.best.squares) - self.solver.cost(found.squares)
            self._adopt(found)
            if gain <= _TOLERANCE:
                break
        if self.best is before:
            self._leave_out("friction: the threshold law does not lower the error")

    def ripple_stage(self) -> None:
        """Fit torque ripple, which repeats with position."""
        before = self.best
        for _ in range(_MOST_ROUNDS):
            new = find_ripples(self.best)
            # At all speeds of the log, or only at speeds whose ripple is below the
            # cut-off.
            limit = partial(in_band, cutoff=self.data.cutoff)
            slow = {j: y for j, x in new.items() if (y := [*map(limit, x)]) != x}
            options = [
                {j: [*self._replaceable(self.best, j), *x] for j, x in ripples.items()}
                for ripples in (new, slow)
            ]
            found = self._accepted(self.best, options, tried=JUDGED)
            if found is self.best:
                break
            self._adopt(found)
        if self.best is not before:
            self._record_stage(before)

    def remainder_stage(self) -> None:
        """Learn the remainder, and fit the physical terms again, until it settles."""
        physical = self.best
        for self.rounds in range(1, _MOST_ROUNDS + 1):
            learned = self._learned(physical)
            if not learned.remainder.parts:
                break
            gain = self.solver.cost(self.squares) - self.solver.cost(learned.squares)
            if gain > 0:
                self.best, self.squares = physical, learned.squares
                self.remainder = learned.remainder
            if gain <= _TOLERANCE:
                break
            physical = self.solver.with_effects(
                physical, physical.effects, learned.cross
            )
        else:
            self.settled = False
        if self.remainder is None:
            self._leave_out("remainder: no regression lowers the error")
        else:
            self._record_stage(self.best)

    def _learned(self, physical: Solution) -> Learned:
        residual = self.data.held_out_residual(physical.problem, physical.theta)
        bound = MOST_LEARNED * self.robot.tau_max
        return fit_remainder(
            self.data, residual, among=self.remainder, bound=bound, seed=self.seed
        )

    def consistent_stage(self) -> None:
        """Make the links physically consistent, and learn the remainder again."""
        free, before = self.best, self.squares
        self._record_stage(free, self.remainder)
        problem, weighted = free.problem, free.weighted
        products = free.products.shared(weighted.share)
        found = physically_consistent(problem, *products.normal(weighted.weight))
        each = zip(*products.without_folds(weighted.weight), strict=True)
        theta = np.array([physically_consistent(problem, A, b).theta for A, b in each])
        self.settled &= found.converged
        self._adopt(
            replace(
                free,
                weighted=replace(weighted, theta=found.theta),
                theta=theta,
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
                "the data contradict them"
            )

    def fit(self, held_out: dict[str, Array]) -> Fit:
        """The accepted terms with their uncertainty.

        Args:
            held_out: RMS of each joint by stage, shape (n,) each, [N·m].

        Raises:
            IdentificationError: The robot file predicts the torque better.
        """
        self._check_against_file()
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
            condition=self.condition,
            converged=converged,
            unidentifiable=unidentifiable(problem, estimate),
            left_out=tuple(self.left_out),
            warnings=tuple(self.warnings),
            rounds=self.rounds,
        )

    def _check_against_file(self) -> None:
        """Refuse a model worse than the file; warn where plain LS is better."""
        file = self.data.squares([self._file_residual(m) for m in self.data.motions])
        total = self.solver.total(self.squares)
        ratio = np.sqrt(total / np.maximum(self.solver.total(file), 1e-300))
        if np.log(np.maximum(ratio, 1e-300)).mean() > _WORSE:
            own = ", ".join(dict.fromkeys(e.id for e in self.extra))
            more = f", without {own} or of more motion" if own else ""
            raise IdentificationError(
                "the model predicts unseen torque worse than the robot file does "
                f"(by {ratio.mean() - 1:.0%} on the mean of the joints); valid are "
                f"logs of this arm whose columns, units and clock are right{more}"
            )
        rise = np.sqrt(total / self.solver.base) - 1.0
        for j in np.flatnonzero(rise > _COSTLY):
            self.warnings.append(
                f"{self.robot.joints[j]}: {rise[j]:.1%} worse than plain least squares "
                "on held-out samples"
            )

    def _file_residual(self, motion: Motion) -> Array:
        body = RigidBody(self.robot.chain, motion)
        return motion.tau - simulated_torque(self.robot, motion, body)

    def _friction_candidates(self, start: Solution) -> dict[int, list[Effect]]:
        """The effects at each joint, with nonlinear friction fitted to the residual."""
        data, model = self.data, self._model(start)
        others = [e for e in start.effects if not self._is_friction(e)]
        frictionless = replace(model, effects=tuple(others))
        rest = [m.tau - frictionless.predict(m) for m in data.motions]
        loads = [model.body(m).load for m in data.motions]
        candidates = {}
        for j in np.flatnonzero(~data.resting).tolist():
            friction = fit_friction(
                data, j, [x[:, j] for x in rest], [x[:, j] for x in loads]
            )
            kept = [e for e in self._replaceable(start, j) if not self._is_friction(e)]
            candidates[j] = [*kept, *friction]
        return candidates

    def _replaceable(self, solution: Solution, joint: int) -> list[Effect]:
        """Effects of one joint that are not the user's."""
        return [
            e
            for e in solution.effects
            if e.joints == (joint,) and not _is_among(e, self.extra)
        ]

    def _accepted(
        self,
        start: Solution,
        options: Sequence[Mapping[int, list[Effect]]],
        *,
        tried: int = 1,
    ) -> Solution:
        """The start with the terms that pass the gate, unless it is better without."""

        def fitted(at: Mapping[int, list[Effect]]) -> Solution:
            effects = self._with_candidates(start, at)
            return self.solver.with_effects(start, effects)

        found = with_accepted(start, options, fitted, tried=tried)
        return self.solver.least([start, found])

    def _with_candidates(
        self, start: Solution, at: Mapping[int, list[Effect]]
    ) -> list[Effect]:
        old = [e for j in at for e in self._replaceable(start, j)]
        kept = [e for e in start.effects if not any(e is x for x in old)]
        return [*kept, *(e for effects in at.values() for e in effects)]

    def _model(
        self, solution: Solution, remainder: ArmRemainder | None = None
    ) -> DynamicModel:
        """A model to compare with, without standard deviations."""
        return solution.model(self.robot, remainder, sure=False)

    def _is_friction(self, effect: Effect) -> bool:
        """Whether the friction stage may replace an effect; the user's ones stay."""
        return isinstance(effect, _FRICTION) and not _is_among(effect, self.extra)

    def _adopt(self, solution: Solution) -> None:
        self.best, self.squares = solution, solution.squares

    def _record_stage(
        self, solution: Solution, remainder: ArmRemainder | None = None
    ) -> None:
        """Keep the model of a finished stage for comparison."""
        model = self._model(solution, remainder)
        self.stages[model.stage] = model

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        self.warnings.append(f"left out {text} on held-out samples")


def _is_among(effect: Effect, others: Sequence[Effect]) -> bool:
    """Whether the others have an effect of the same class at the same joints."""
    return any(type(effect) is type(e) and effect.joints == e.joints for e in others)
