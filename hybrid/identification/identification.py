"""The stages of one identification, and the best terms found so far.

The stages: the rigid body with linear friction, nonlinear friction, ripple, a learned
remainder, and physically consistent links. A new term of a joint is accepted only if it
lowers the held-out error of the predicted torque; see ``gate.py``.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import Effect
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.friction_lag import FrictionLag
from hybrid.effects.load_friction import LoadFriction
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.errors import IdentificationError
from hybrid.identification.consistency import physically_consistent
from hybrid.identification.fit import Fit, poor_excitation, unidentifiable
from hybrid.identification.friction import fit_friction
from hybrid.identification.gate import Terms, with_accepted
from hybrid.identification.remainder import fit_remainder
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
_LAGS = 5  # times of frictional lag that are tried, in equal ratios
_MOST_ROUNDS = 4
_TOLERANCE = 0.005  # relative fall of the held-out error at which iterations end
# Largest torque of a learned remainder, as a share of the rated torque. If it is ever
# wrong, the brakes and limits of the arm must be able to master it.
MOST_LEARNED = 0.3
_WORSE = 0.05  # relative rise of the error above that of the file that is refused
_COSTLY = 0.01  # relative rise of the held-out error that gives a warning


class Identification:
    """The best terms found so far."""

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
        self.simpler: dict[str, DynamicModel] = {}
        self.left_out: list[str] = []
        self.warnings: list[str] = []
        self.rounds, self.settled = 1, True

    best: Solution
    condition: float

    def rigid_stage(self, products: CrossProducts) -> dict[str, Array]:
        """Fit the rigid body with linear friction, whose cross-products are given.

        Returns the held-out RMS of each joint by estimator, and of the best one with
        the prior, shape (n,) each, [N·m].
        """
        if any(e.changes_signals for e in self.extra):
            products, self.settled = self.solver.linearised(products)
        plain = self.solver.plain(products)
        A, _ = products.normal(plain[self.estimator].weighted.weight)
        self.condition = condition_number(A)
        poor = poor_excitation(products.problem, A)
        if poor:
            self.warnings.append(poor)
        found = {name.upper(): solution for name, solution in plain.items()}
        self.simpler = {name: self._model(x) for name, x in found.items()}
        self.best = found["rigid"] = self.solver.best(products)
        self._record_stage(self.best)
        return {name: self.solver.rms(x.squares) for name, x in found.items()}

    @property
    def error(self) -> Array:
        """Held-out RMS of each joint, shape (n,), [N·m]."""
        return self.solver.rms(self.best.squares)

    def friction_stage(self) -> None:
        """Fit nonlinear friction, then all terms again, until the error settles.

        After that friction may follow the speed late.
        """
        if not self._extend(self._friction_candidates, tolerance=_TOLERANCE):
            self._leave_out("friction: the threshold law does not lower the error")
        self._extend(self._lag_candidates, tolerance=_TOLERANCE, tried=_LAGS)

    def ripple_stage(self) -> None:
        """Fit torque ripple, which repeats with position."""
        before = self.best
        if self._extend(self._ripple_candidates, tried=JUDGED):
            self._record_stage(before)

    def remainder_stage(self) -> None:
        """Learn the remainder, and fit the physical terms again, until it settles."""
        physical = self.best
        for self.rounds in range(1, _MOST_ROUNDS + 1):
            found, cross = self._with_remainder(physical)
            if found.remainder is None:
                break
            gain = self._gain(found)
            if gain > 0:
                self.best = found
            if gain <= _TOLERANCE:
                break
            physical = self.solver.with_effects(physical, physical.effects, cross)
        else:
            self.settled = False
        if self.best.remainder is None:
            self._leave_out("remainder: no regression lowers the error")
        else:
            self._record_stage(replace(self.best, remainder=None))

    def _with_remainder(self, physical: Solution) -> tuple[Solution, list[Array]]:
        """Physical terms with a learned remainder, and its cross-validated torque."""
        residual = self.data.held_out_residual(physical.problem, physical.theta)
        remainder, cross = fit_remainder(
            self.data,
            residual,
            among=self.best.remainder,
            bound=MOST_LEARNED * self.robot.tau_max,
            seed=self.seed,
        )
        left = [x - y for x, y in zip(residual, cross, strict=True)]
        found = replace(
            physical,
            remainder=remainder if remainder.parts else None,
            corrected=self.data.squares(left),
        )
        return found, cross

    def consistent_stage(self) -> None:
        """Make the links physically consistent, and learn the remainder again."""
        before = self.best
        self._record_stage(before)
        problem, weighted = before.problem, before.weighted
        products = before.products.shared(weighted.share)
        found = physically_consistent(problem, *products.normal(weighted.weight))
        each = zip(*products.without_folds(weighted.weight), strict=True)
        theta = np.array([physically_consistent(problem, A, b).theta for A, b in each])
        self.settled &= found.converged
        after = replace(
            before,
            weighted=replace(weighted, theta=found.theta),
            theta=theta,
            inertial=found.inertial,
            beside=found.beside,
            corrected=None,
        )
        if before.remainder is not None:
            after, _ = self._with_remainder(after)
        self.best = after
        change = self.solver.cost(after.squares, harm=0.0)
        change -= self.solver.cost(before.squares, harm=0.0)
        cost = np.exp(change) - 1.0
        if cost > _COSTLY:
            self.warnings.append(
                f"physically consistent links raise the held-out error by {cost:.1%}; "
                "the data contradict them"
            )

    def fit(self, held_out: dict[str, Array]) -> Fit:
        """The accepted terms with their uncertainty, and the RMS by stage.

        Raises:
            IdentificationError: The robot file predicts the torque better.
        """
        self._check_against_file()
        problem, estimate = self.best.problem, self.best.estimate
        model = self.best.model(self.robot)
        converged = estimate.converged and self.settled
        if not converged:
            self.warnings.append("the iteration did not settle; see Fit.converged")
        return Fit(
            model=replace(model, simpler=self.simpler, covariance=estimate.covariance),
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
        total = self.solver.total(self.best.squares)
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
                f"{self.robot.joints[j]}: {rise[j]:.1%} worse on held-out samples than "
                "the better of plain and weighted least squares"
            )

    def _file_residual(self, motion: Motion) -> Array:
        body = RigidBody(self.robot.chain, motion)
        tau = simulated_torque(self.robot, motion, body)
        return motion.tau - self.data.seen(motion, tau)

    def _friction_candidates(self, start: Solution) -> list[Terms]:
        """The effects at each joint, with nonlinear friction fitted to the residual."""
        data, model = self.data, self._model(start)
        others = [e for e in start.effects if not self._is_friction(e)]
        frictionless = replace(model, effects=tuple(others))
        rest = [m.tau - data.seen(m, frictionless.predict(m)) for m in data.motions]
        loads = [model.body(m).load for m in data.motions]
        candidates = {}
        for j in np.flatnonzero(~data.resting).tolist():
            friction = fit_friction(
                data, j, [x[:, j] for x in rest], [x[:, j] for x in loads]
            )
            kept = [e for e in self._replaceable(start, j) if not self._is_friction(e)]
            candidates[j] = [*kept, *friction]
        return [candidates]

    def _lag_candidates(self, start: Solution) -> list[Terms]:
        """The effects at each joint, with the frictional lag that lowers its error."""
        (time,) = FrictionLag.shapes
        options, found = [], []
        for lag in np.geomspace(time.lower, time.upper, _LAGS).tolist():
            terms: dict[int, list[Effect]] = {}
            for j in np.flatnonzero(~self.data.resting).tolist():
                own = self._replaceable(start, j)
                own = [e for e in own if not isinstance(e, FrictionLag)]
                terms[j] = [*own, FrictionLag((j,), {time.name: lag})]
            options.append(terms)
            found.append(self._fitted(start, terms))
        best = np.argmin([self.solver.total(x.squares) for x in found], axis=0)
        lagging = {
            e.joints[0] for k, x in enumerate(found) for e in x.effects
            if isinstance(e, FrictionLag) and best[e.joints[0]] == k
            and any(e.gain_values)
        }  # fmt: skip
        return [{j: options[best[j]][j] for j in lagging}]

    def _ripple_candidates(self, start: Solution) -> list[Terms]:
        """The effects at each joint, with ripples that lower its error.

        They act at all speeds of the log, or only at speeds whose ripple is below the
        cut-off.
        """
        new = find_ripples(start)
        limit = partial(in_band, cutoff=self.data.cutoff)
        slow = {j: y for j, x in new.items() if (y := [*map(limit, x)]) != x}
        return [
            {j: [*self._replaceable(start, j), *x] for j, x in ripples.items()}
            for ripples in (new, slow)
        ]

    def _replaceable(self, solution: Solution, joint: int) -> list[Effect]:
        """Effects of one joint that are not the user's."""
        own = [e for e in solution.effects if e.joints == (joint,)]
        return [e for e in own if not self._is_given(e)]

    def _extend(
        self,
        candidates: Callable[[Solution], list[Terms]],
        *,
        tolerance: float = 0.0,
        tried: int = 1,
    ) -> bool:
        """Add terms that pass the gate, until the cost falls by a tolerance or less.

        Returns whether any were added.
        """
        before = self.best
        for _ in range(_MOST_ROUNDS):
            options, fitted = candidates(self.best), partial(self._fitted, self.best)
            found = with_accepted(self.best, options, fitted, tried=tried)
            gain = self._gain(found)
            if gain > 0:
                self.best = found
            if gain <= tolerance:
                break
        return self.best is not before

    def _fitted(self, start: Solution, terms: Terms) -> Solution:
        """The solution with other effects at some joints."""
        old = {(j,) for j in terms}
        kept = [e for e in start.effects if e.joints not in old or self._is_given(e)]
        new = [e for effects in terms.values() for e in effects]
        return self.solver.with_effects(start, [*kept, *new])

    def _gain(self, solution: Solution) -> float:
        """The cost of the best solution less that of another."""
        cost = self.solver.cost
        return cost(self.best.squares) - cost(solution.squares)

    def _model(self, solution: Solution) -> DynamicModel:
        """A model to compare with, without standard deviations."""
        return solution.model(self.robot, sure=False)

    def _is_friction(self, effect: Effect) -> bool:
        """Whether the friction stage may replace an effect; the user's ones stay."""
        return isinstance(effect, _FRICTION) and not self._is_given(effect)

    def _is_given(self, effect: Effect) -> bool:
        """Whether the user gave an effect of the same class at the same joints."""
        return any(
            type(effect) is type(e) and effect.joints == e.joints for e in self.extra
        )

    def _record_stage(self, solution: Solution) -> None:
        """Keep the model of a finished stage for comparison."""
        model = self._model(solution)
        self.simpler[model.stage] = model

    def _leave_out(self, text: str) -> None:
        self.left_out.append(text)
        self.warnings.append(f"left out {text} on held-out samples")
