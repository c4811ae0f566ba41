"""Dynamic parameters tracked sample by sample while the arm works.

Source: Ljung and Söderström 1983, "Theory and Practice of Recursive Identification"
(extended least squares); see also ``square_root.py`` and ``payload_change.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.effects import Effect
from hybrid.errors import IdentificationError
from hybrid.identify.model import DynamicModel
from hybrid.identify.online_noise import TorqueNoise
from hybrid.identify.online_start import REACH, Start, payload_sizes
from hybrid.identify.payload_change import Change, PayloadChange, likely_payload
from hybrid.identify.problem import build_problem
from hybrid.identify.sample_columns import SampleColumns
from hybrid.identify.square_root import SquareRootFilter
from hybrid.parameters import Parameter
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals.streaming import StreamingDerivative, StreamingLowPass

_STANDING = 0.01  # of a joint's rated speed
_NOISE = 0.02  # of the rated torque, before the first sample
_SURPRISE = 5.0  # standard deviations to which an error is cut
_UPDATES = 5.0  # per period of the cut-off
_SETTLING = 1.5  # periods of the cut-off for which rows mix what was with what is


@dataclass(frozen=True)
class Sample:
    """What a controller knows at one instant.

    Attributes:
        t: Time, [s].
        q: Joint position, shape (n,), [rad].
        tau: Drive torque, shape (n,), [N·m].
        v: Joint speed, shape (n,), [rad/s]; with ``a``, or None to differentiate q.
        a: Joint acceleration, shape (n,), [rad/s²], or None.
    """

    t: float
    q: Array
    tau: Array
    v: Array | None = None
    a: Array | None = None


class OnlineIdentifier:
    """Base parameters and the gains and shapes of effects, always up to date.

    Positions are differentiated by local polynomials, columns and torque pass the same
    low-pass, and an extended square-root filter takes them in, a few times per period
    of the cut-off. Joints that stand do not count: their friction is not known.
    Gains and shapes stay within their physical bounds. A payload grasped or dropped is
    noticed, and the parameters it moves are then found anew.

    Args:
        robot: The arm.
        effects: Effects with their first values; they must add torque. Shapes are
            tracked unless ``shape_prior`` is 0.
        rate: Samples per second, [Hz].
        inertial: First link parameters, shape (n, 10); the robot file's by default.
        cutoff: Cut-off of columns and torque, [Hz]; inf if samples bring their speed
            and acceleration and are free of noise.
        memory: Time over which parameters are averaged once they are known, [s].
        prior: Relative standard deviation of link parameters and gains at first.
        shape_prior: The same for shapes.
        payload: Usual mass of a payload, [kg].
        standing: Speed below which a joint stands, shape (n,), [rad/s]; 1 % of its
            rated speed by default.
        noise: Standard deviation of the torque at first, shape (n,), [N·m]; it is
            tracked as well.

    Raises:
        IdentificationError: An effect cannot be tracked, or an option is out of range.
    """

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
        payload: float = 3.0,
        standing: Array | None = None,
        noise: Array | None = None,
    ) -> None:
        if not (rate > 0 and cutoff > 0 and memory > 0 and payload > 0 and prior > 0):
            raise IdentificationError(
                "rate, cutoff, memory, prior and payload must be above 0"
            )
        self.robot = robot
        own = robot.chain.inertial if inertial is None else inertial
        problem = build_problem(robot.chain, effects, inertial=own)
        start = Start(robot, problem, own, prior, shape_prior)
        self.problem = replace(problem, effects=start.effects)
        self._columns = SampleColumns(robot, self.problem)
        self._filter = SquareRootFilter(start.theta, start.root)
        self._lower, self._upper = start.bounds()
        self._payload_sizes = payload_sizes(payload)
        self._payload = start.payload_directions(self._payload_sizes)
        scales = joint_scales(robot)
        usual = np.array([[_NOISE * s.torque, _STANDING * s.speed] for s in scales]).T
        self._standing = usual[1] if standing is None else standing
        self._delay: StreamingDerivative | None = None
        self._smooth: StreamingLowPass | None = None
        self._every = 1
        if np.isfinite(cutoff):
            self._delay = StreamingDerivative(rate, cutoff, robot.size)
            self._smooth = StreamingLowPass(rate, cutoff)
            self._every = max(1, int(rate / (_UPDATES * cutoff)))
        self.rate = rate
        updates = rate / self._every
        unknown_per_row = len(start.theta) / robot.size
        self._forgetting = 1.0 - min(0.5, unknown_per_row / (memory * updates))
        self._noise = TorqueNoise(usual[0] if noise is None else noise, updates)
        self._detector = PayloadChange(rate=updates, mass=payload, reach=REACH)
        self._count = 0
        self._before = self._filter.mean.copy(), self._filter.covariance
        self._mixing = _SETTLING / cutoff
        self._learn_from = -np.inf
        self.changes: list[Change] = []
        self.error = np.zeros(robot.size)

    @classmethod
    def from_model(
        cls, model: DynamicModel, *, rate: float, prior: float = 0.05
    ) -> OnlineIdentifier:
        """Track on from an identified model; its learned remainder is left out."""
        inertial = model.base.standard()[: 10 * model.robot.size]
        return cls(
            model.robot,
            model.effects,
            rate=rate,
            inertial=inertial.reshape(-1, 10),
            cutoff=min(model.cutoff, 10.0),
            prior=prior,
            shape_prior=0.0,
            standing=model.standing if model.standing.size else None,
        )

    @property
    def delay(self) -> float:
        """How long ago the newest sample was that is in the estimate, [s]."""
        return self._delay.delay / self.rate if self._delay else 0.0

    @property
    def theta(self) -> Array:
        """Unknowns: base parameters and gains, then the shapes; shape (d,)."""
        return self._filter.mean.copy()

    @property
    def std(self) -> Array:
        """Their standard deviations, shape (d,)."""
        return self._filter.std

    @property
    def noise(self) -> Array:
        """Standard deviation of the torque error, shape (n,), [N·m]."""
        return self._noise.std.copy()

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Every unknown by name, with unit, bounds and standard deviation."""
        base = self.problem.base
        names = [*base.kept_labels]
        units = [base.units[k] for k in base.kept]
        for effect in self.problem.effects:
            where = "+".join(self.robot.joints[j] for j in effect.joints)
            where = "arm" if effect.scope == "arm" else where
            names += [f"{effect.id}.{s.name}[{where}]" for s in effect.shapes]
            units += [s.unit for s in effect.shapes]
        values = (self._filter.mean, self._lower, self._upper)
        rows = zip(
            names, *(x.tolist() for x in values), units, self.std.tolist(), strict=True
        )
        return tuple(Parameter(*row) for row in rows)

    @property
    def model(self) -> DynamicModel:
        """The model of this moment."""
        p = self.problem.size
        base, effects = self.problem.fitted(self._filter.mean[:p])
        shapes, changed = iter(self._filter.mean[p:].tolist()), []
        for effect in effects:
            changed.append(effect.at({s.name: next(shapes) for s in effect.shapes}))
        return DynamicModel(self.robot, base, tuple(changed), standing=self._standing)

    @property
    def taken(self) -> Array:
        """What the last link carries more than before the last change, shape (10,).

        Mass, first moments and inertia about its frame origin; what the torque cannot
        tell of them is as small as it can be.
        """
        mean, covariance = self._before
        change = self._filter.mean - mean
        spread = covariance + self._filter.covariance
        return likely_payload(change, spread, self._payload, self._payload_sizes)

    def update(self, sample: Sample) -> Change | None:
        """Take in one sample.

        Returns:
            The payload change that was noticed with this sample, if any.
        """
        state = self._state(sample)
        if state is None:
            return None
        q, v, a, tau = state
        t = sample.t - self.delay
        moving = (np.abs(v) > self._standing).astype(float)[:, None]
        rows = np.zeros((len(q), len(self._filter.mean) + 12))
        if moving.any():
            J, last = self._columns(q, v, a, self._filter.mean, t)
            columns = [J, last, tau[:, None], moving]
            rows = np.concatenate(columns, axis=1) * moving
        rows = self._smooth(rows) if self._smooth else rows
        self._count += 1
        if self._count % self._every:
            return None
        return self._learn(sample.t, rows)

    def _state(self, sample: Sample) -> tuple[Array, Array, Array, Array] | None:
        if sample.v is not None and sample.a is not None:
            return sample.q, sample.v, sample.a, sample.tau
        if self._delay is None:
            raise IdentificationError(
                "without a cut-off every sample needs its speed and acceleration"
            )
        return self._delay.push(sample.q, sample.tau)

    def _learn(self, t: float, rows: Array) -> Change | None:
        d, p = len(self._filter.mean), self.problem.size
        J, last, tau, part = rows[:, :d], rows[:, d:-2], rows[:, -2], rows[:, -1]
        self.error = tau - J[:, :p] @ self._filter.mean[:p]
        used = part > 0.5
        if t < self._learn_from or not used.any():
            return None
        repeats = self._noise.repeats
        size = self._noise.std[used] * np.sqrt(repeats)
        H, error = J[used] / size[:, None], self.error[used] / size
        spread = np.sqrt(1.0 + self._filter.leverage(H))
        one = self._noise.std[used] * spread
        change = self._detector.update(
            t, last[used] / one[:, None], self.error[used] / one, repeats
        )
        if change is not None:
            self.changes.append(change)
            self._before = self._filter.mean.copy(), self._filter.covariance
            self._filter.widen(self._payload)
            self._learn_from = t + self._mixing
            return change
        limit = _SURPRISE * spread
        self._filter.update(H, np.clip(error, -limit, limit), self._forgetting)
        self._filter.keep_within(self._lower, self._upper)
        self._noise.update(used, self.error[used] / spread)
        return None
