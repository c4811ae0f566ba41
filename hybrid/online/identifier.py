"""Online identification of dynamic parameters, sample by sample.

Source: Ljung and Söderström 1983, "Theory and Practice of Recursive Identification"
(extended least squares); see also ``square_root.py`` and ``payload_change.py``.

Samples are processed in blocks. While a block fills, each call does a part of the work
of the previous block, so no call takes long: about ten microseconds a step, and a few
tenths of a millisecond for the call that detects a payload. At low rates a block has a
few samples, and without a cut-off one, so a call does more of the work.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from hybrid.arguments import typed
from hybrid.arrays import Array
from hybrid.effects import Effect
from hybrid.errors import IdentificationError
from hybrid.model.dynamic_model import DynamicModel
from hybrid.online.columns import InstantColumns
from hybrid.online.estimate import OnlineEstimate
from hybrid.online.health import Health
from hybrid.online.initial_estimate import InitialEstimate
from hybrid.online.intake import Intake, Sample
from hybrid.online.layout import RowLayout
from hybrid.online.payload_change import Change
from hybrid.online.pipeline import Pipeline
from hybrid.parameters import Parameter
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial

_STANDING = 0.01  # of a joint's rated speed
_NOISE = 0.02  # of the rated torque, before the first sample
_IMPLAUSIBLE = 10.0  # of the sum of the rated speeds, and of the rated torques
_UPDATES, _ROWS = 5.0, 25.0  # per period of the cut-off
_PASSED = 0.5  # of a logger's bandwidth, below which its filter leaves nearly all
_SETTLING = 1.5  # periods of the cut-off in which the filter still holds older samples


class OnlineIdentifier:
    """Tracks base parameters, and the gains and shapes of effects, sample by sample.

    Positions are differentiated by local polynomials. Columns and torque pass the same
    low-pass filter, and update an extended square-root filter a few times per period of
    the cut-off. Joints at standstill are left out, because their friction is unknown.
    Gains and shapes stay within their physical bounds. A payload that is grasped or
    dropped is detected, and the parameters that it changes are then estimated again.

    Samples that are not finite, repeated, late or implausible are rejected. Short gaps
    are bridged by the time stamps; after long ones the derivatives start again.
    ``health`` counts the samples.

    Args:
        robot: The arm.
        effects: Effects with their initial values; they must add the torque of a
            state. Shapes are tracked unless ``shape_prior`` is 0.
        rate: Samples per second, [Hz].
        inertial: Initial link parameters, shape (n, 10); the robot file's by default.
        cutoff: Cut-off of columns and torque, [Hz]; inf if samples contain speed and
            acceleration and have no noise.
        memory: Time over which parameters are averaged, [s].
        prior: Initial relative standard deviation of link parameters and gains.
        shape_prior: Initial relative standard deviation of shapes.
        standing: Speed below which a joint stands, shape (n,), [rad/s]; 1 % of its
            rated speed by default.
        noise: Initial standard deviation of the torque, shape (n,), [N·m]; it is
            tracked as well.

    Raises:
        IdentificationError: An effect cannot be tracked, or an option is out of range.
    """

    @typed
    def __init__(
        self,
        robot: Robot,
        effects: Sequence[Effect] = (),
        *,
        rate: float,
        inertial: Array | None = None,
        cutoff: float = 10.0,
        memory: float = 20.0,
        prior: float = 0.3,
        shape_prior: float = 0.3,
        standing: Array | None = None,
        noise: Array | None = None,
    ) -> None:
        if not (rate > 0 and cutoff > 0 and memory > 0 and prior > 0):
            raise IdentificationError("rate, cutoff, memory and prior must be above 0")
        for effect in (e for e in effects if e.changes_signals or e.warms):
            why = "changes signals" if effect.changes_signals else "warms with use"
            raise IdentificationError(
                f"{effect.id} {why} and cannot be tracked sample by sample; "
                "valid are effects that add the torque of a state"
            )
        self.robot, self.rate = robot, rate
        # Of gains with dependent columns, those that are zero are no unknowns.
        zero = [
            (e, x) for e, y in enumerate(effects) for x, v in y.values.items() if not v
        ]
        nonzero = build_problem(robot.chain, effects, inertial=inertial, without=zero)
        problem = nonzero.complete()
        scales = self._scales = joint_scales(robot)
        start = InitialEstimate(problem, scales, prior, shape_prior)
        self.problem = replace(problem, effects=start.effects)
        usual = np.array([[_NOISE * s.torque, _STANDING * s.speed] for s in scales]).T
        self._standing = usual[1] if standing is None else standing
        self._group = int(rate / (_ROWS * cutoff)) or 1
        rows = int(rate / (_UPDATES * cutoff * self._group)) or 1
        self._block = rows * self._group
        self._differentiator, self._low_pass = None, None
        if np.isfinite(cutoff):
            self._differentiator = LocalPolynomial(rate, cutoff, self._group)
            self._low_pass = BlockLowPass(rate / self._group, cutoff, rows)
        layout = RowLayout(self.problem, shape_prior > 0)
        self._columns = InstantColumns(robot, self.problem, layout, rows)
        updates, size = rate / self._block, len(start.theta)
        self._estimate = OnlineEstimate(
            start,
            layout,
            rate=updates,
            noise=usual[0] if noise is None else noise,
            forgetting=1.0 - min(0.5, size / robot.size / (memory * updates)),
            mixing=_SETTLING / cutoff,
        )
        self._intake: Intake | None = None
        self._pipeline: Pipeline
        # Work on the last block: its calls, its steps, and those of the longest block.
        self._work: Iterator[None] = iter(())
        self._calls, self._done, self._steps = self._block, 0, self._block
        self._change: Change | None = None
        self.changes: list[Change] = []
        self._origin = DynamicModel(
            robot, problem.base, cutoff=cutoff, standing=self._standing
        )

    def __repr__(self) -> str:
        name, seen = self.robot.name, self.health.summary
        return f"<OnlineIdentifier of {name} at {self.rate:.4g} Hz: {seen}>"

    @classmethod
    @typed
    def from_model(
        cls, model: DynamicModel, *, rate: float, prior: float = 0.05
    ) -> OnlineIdentifier:
        """Start from an identified model; its learned remainder is left out.

        Torque is expected from the same logger, which may have filtered it.
        """
        inertial = model.base.standard()[: 10 * model.robot.size]
        tracker = cls(
            model.robot,
            model.effects,
            rate=rate,
            inertial=inertial.reshape(-1, 10),
            cutoff=min(model.cutoff, _PASSED * model.band, 10.0),
            prior=prior,
            shape_prior=0.0,
            standing=model.standing if model.standing.size else None,
        )
        nothing = np.zeros((0, 0))
        tracker._origin = replace(
            model, remainder=None, inertial=None, covariance=nothing, simpler={}
        )
        return tracker

    @property
    def delay(self) -> float:
        """Delay of the estimate after the newest sample, [s]."""
        return (self._margin + self._block - 1) / self.rate

    @property
    def _margin(self) -> int:
        return self._differentiator.margin if self._differentiator else 0

    @property
    def health(self) -> Health:
        """Counts of accepted and rejected samples, and their rate."""
        return self._intake.health if self._intake else Health(stated_rate=self.rate)

    @property
    def error(self) -> Array:
        """Filtered prediction error of the torque, shape (n,), [N·m]."""
        return self._estimate.error

    @property
    def theta(self) -> Array:
        """Unknowns: base parameters and gains, then the shapes; shape (d,)."""
        return self._estimate.filter.mean.copy()

    @property
    def std(self) -> Array:
        """Their standard deviations, shape (d,)."""
        return self._estimate.filter.std

    @property
    def noise(self) -> Array:
        """Standard deviation of the torque error, shape (n,), [N·m]."""
        return self._estimate.noise.std.copy()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every unknown by name, with unit, bounds and standard deviation."""
        base, unit_at = self.problem.base, self.robot.chain.unit_at
        names, units = [*base.kept_labels], [base.units[k] for k in base.kept]
        for effect in self.problem.effects:
            where = "+".join(self.robot.joints[j] for j in effect.joints)
            where = "arm" if effect.scope == "arm" else where
            names += [f"{effect.id}.{s.name}[{where}]" for s in effect.shapes]
            units += [unit_at(effect.unit_joints, s.unit) for s in effect.shapes]
        values = (self._estimate.filter.mean, *self._estimate.bounds, self.std)
        value, lower, upper, std = (x.tolist() for x in values)
        return tuple(map(Parameter, names, value, lower, upper, units, std))

    @property
    def model(self) -> DynamicModel:
        """The model with the present values."""
        p = self.problem.size
        base, effects = self.problem.fitted(self._estimate.filter.mean[:p])
        shapes = iter(self._estimate.filter.mean[p:].tolist())
        found = tuple(e.at({s.name: next(shapes) for s in e.shapes}) for e in effects)
        return replace(self._origin, base=base, effects=found)

    @property
    def taken(self) -> Array:
        """Payload that the last change added to the last link, shape (10,).

        Mass, first moments and inertia about the origin of its frame. Undetermined
        parameters are as small as possible.
        """
        return self._estimate.taken

    def update(self, sample: Sample) -> Change | None:
        """Accept one sample, or reject it; see :attr:`health`.

        Returns:
            The payload change that was detected with this sample, if any.

        Raises:
            IdentificationError: This is no sample, or one of the wrong shape, or it
                lacks the speed and acceleration that it needs.
        """
        if not isinstance(sample, Sample):
            kind = type(sample).__name__
            raise IdentificationError(f"sample is of type {kind}; valid is a Sample")
        if self._intake is None:
            self._intake = self._start(sample)
        block = self._intake.take(sample)
        if block is not None:
            self._work = self._learn(block, self._intake)
            self._calls = self._done = 0
        self._change = None
        if self._calls < self._block:
            self._calls += 1
            last = self._calls == self._block
            due = self._calls * self._steps // self._block - self._done
            for _ in islice(self._work, None if last else due):
                self._done += 1
            self._steps = max(self._steps, self._done)
        return self._change

    def _learn(self, block: Array, intake: Intake) -> Iterator[None]:
        """Update with a block of samples, in steps that take about as long each."""
        row = yield from self._pipeline.row(block, self._estimate.filter.mean)
        found = yield from self._estimate.learn(row, float(block[-1, 0]))
        if found is not None:
            self._change = Change(intake.now, found)
            self.changes.append(self._change)

    def _start(self, sample: Sample) -> Intake:
        """Intake and pipeline for the signals that the first sample has."""
        if sample.v is not None and sample.a is not None:
            self._differentiator = None
        elif self._differentiator is None:
            raise IdentificationError(
                "without a cut-off every sample needs its speed and acceleration"
            )
        self._pipeline = Pipeline(
            self._columns,
            group=self._group,
            differentiator=self._differentiator,
            low_pass=self._low_pass,
            standing=self._standing,
        )
        return Intake(
            self.robot.size,
            rate=self.rate,
            window=self._differentiator.span if self._differentiator else 0.0,
            speed=_IMPLAUSIBLE * sum(s.speed for s in self._scales),
            torque=_IMPLAUSIBLE * sum(s.torque for s in self._scales),
            before=2 * self._margin,
            block=self._block,
        )
