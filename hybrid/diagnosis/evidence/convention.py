"""The logging convention: the instant at which the logged torque acted.

A simulation that steps before it logs writes the position after the step beside the
torque before it. In an implicit step the servo's damping acts at the final speed, while
the logged torque is that of the initial speed: over a step h it is too high by
``h k_d a``. Both are errors of the log, and are corrected where they are the most
probable explanation (MacKay 1992, doi 10.1162/neco.1992.4.3.415). Torque that is late
by another time, as if stamped by another clock, is corrected as well, and is reported
as a cause.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Candidate, candidate, usual
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise_model import estimate_noise
from hybrid.diagnosis.gap.background import background, friction_near_rest
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.diagnosis.prior import Prior
from hybrid.effects import Port, effect_at, effect_classes
from hybrid.identification.preparation import FEWEST_PERIODS
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion
from hybrid.signals.bandwidth import FILTERED

_OPEN = 0.1  # s, prior standard deviation of a joint's own delay or step
_LINEARITY = 0.1  # of a common time: error of columns that are linear in it


@dataclass(frozen=True)
class Convention:
    """How torque was logged.

    Attributes:
        late: Delay of the logged torque behind the logged position, [s].
        step: Implicit step h that the logged damping leaves out, [s].
        std: Standard deviation of ``late``, [s], if torque and position were stamped by
            different clocks; 0 if the delay is a step of the simulation.
        bandwidth: Frequency above which a filter has removed torque, [Hz].
    """

    late: float = 0.0
    step: float = 0.0
    std: float = 0.0
    bandwidth: float = np.inf

    def __bool__(self) -> bool:
        return self.late > 0 or self.step > 0

    @property
    def clocks(self) -> bool:
        """Whether different clocks stamped torque and position."""
        return self.std > 0

    def shift(self, log: Recording | Motion) -> Recording | Motion:
        """A log with torque and command shifted to the instant of each position."""
        if not self.late:
            return log
        # It is unknown which of two clocks stamps the command.
        if isinstance(log, Motion) or log.command is None or self.clocks:
            return replace(log, tau=self._later(log.t, log.tau))
        command = self._later(log.t, log.command)
        return replace(log, tau=self._later(log.t, log.tau), command=command)

    def _later(self, t: Array, x: Array) -> Array:
        """A signal at later times; its last samples stay as they are."""
        then = t + self.late
        moved = np.stack([np.interp(then, t, y) for y in x.T], axis=1)
        return np.where((then > t[-1])[:, None], x, moved)

    def correct(self, robot: Robot, motion: Motion) -> Motion:
        """A motion with the damping of the final speed, and the speed of its friction.

        Samples at its end, for which no torque was logged, are masked.
        """
        missing = int(np.ceil(self.late * motion.rate))
        mask = motion.mask.copy()
        mask[: len(mask) - missing] &= motion.mask[missing:]
        mask[len(mask) - missing :] = False
        taken = self.step * np.nan_to_num(robot.kd) * motion.a
        ahead = self.step if self.clocks else max(self.late, self.step)
        v = motion.v + ahead / 2 * motion.a
        return replace(motion, tau=motion.tau - taken, v=v, mask=mask)

    @property
    def notes(self) -> tuple[str, ...]:
        """The corrections, in words."""
        found = []
        if self.bandwidth < np.inf:
            found.append(FILTERED.format(self.bandwidth))
        if self.clocks:
            found.append(
                f"torque is logged {1e3 * self.late:.3g} ms late at every joint: all "
                "other results are for the log without this delay"
            )
        elif self.late:
            found.append(
                f"torque is logged {1e3 * self.late:.3g} ms late at every joint, as by "
                "a simulation that steps before it logs: corrected"
            )
        if self.step:
            found.append(
                "torque is logged with the servo's damping at the start of an implicit "
                f"step of {1e3 * self.step:.3g} ms: corrected"
            )
        return tuple(found)


def find_convention(
    gap: Gap, recordings: Sequence[Recording | Motion], *, clocks: bool = True
) -> Convention:
    """Find the most probable logging convention.

    The torque of each joint has a delay, and the damping of each servo a step. Either
    is zero at all joints, not zero at one joint, different at every joint, or common.

    Args:
        gap: The gap, without any correction.
        recordings: The recordings from which it was measured.
        clocks: Whether torque and position may be stamped by different clocks.
    """
    robot = gap.robot
    shortest = min(float(m.t[-1] - m.t[0]) for m in gap.motions)
    # Noise of an acceleration's derivative grows with the cube of frequency.
    lower = max(gap.lower_cutoff(), FEWEST_PERIODS / shortest)
    measured = partial(measure_gap, robot, cutoff=lower)
    gap = measured(recordings)
    if not gap.moving.any():
        return Convention()
    steps = sorted(x for x in {gap.period, robot.timestep} if x > 0)
    evidence = _TimeEvidence(gap)
    # The log does not tell when torque was read within a sample.
    least = gap.period if clocks else np.inf
    delays, damped = evidence.most_probable(steps, least)
    late, step = delays.common, damped.common
    if not (late or step) or not evidence.is_cross_validated():
        return Convention()
    if not late or late in steps:
        return Convention(late, step)
    # The first estimate is linear in the time: it is repeated after a shift.
    first = Convention(late, step, evidence.common_delay(step)[1])
    shifted = measured([first.shift(x) for x in recordings])
    more, std = _TimeEvidence(shifted).common_delay(step)
    return Convention(late + more, step, std)


@dataclass(frozen=True)
class _TimePrior:
    """A Gaussian prior of some times, one for each joint, [s].

    Attributes:
        cost: Log odds against it, [nat].
        root: A root of the covariance, shape (p, k).
        common: Mean of all times.
    """

    cost: float
    root: Array
    common: float = 0.0


class _TimeEvidence:
    """Evidence for the delay of each joint's torque, and for each servo's step."""

    def __init__(self, gap: Gap) -> None:
        robot, prior = gap.robot, Prior()
        joints = [j for j in range(robot.size) if gap.moving[:, j].any()]
        servo = [j for j in joints if robot.kd[j] > 0]
        evidence, self._cause = Evidence(gap), prior.cause
        numbers = np.concatenate(evidence.add(*background(gap)))
        evidence.scale_prior(numbers, prior.file_errors[0])
        evidence.add(*friction_near_rest(gap))
        beside = [c for c in _nuisances(gap) if {*joints} & {*c.effect.joints}]
        # Where a servo is damped, a law of acceleration is the step.
        rotors = [c for c in beside if c.effect.usual and c.effect.differentiates]
        steps = {c.effect.joints[0]: c for c in rotors if c.effect.joints[0] in servo}
        beside = [c for c in beside if c not in steps.values()]
        evidence.add([gap.columns(c.effect) for c in beside], [c.std for c in beside])
        self._base = np.arange(evidence.size)
        damped = [{j: robot.kd[j] * gap.columns(steps[j].effect)[j]} for j in servo]
        delays = [_delay_columns(gap, j) for j in joints]
        evidence.add([*delays, *damped], [np.array([_OPEN])] * len(joints + servo))
        self._evidence, self._sizes = evidence, (len(joints), len(servo))
        every = np.arange(evidence.size)
        estimate_noise(evidence, every)
        A, b = evidence.normal(every)
        k = len(self._base)
        A[:k, :k] += np.diag(evidence.precision[:k])
        times = np.column_stack([A[k:, k:], b[k:]])
        across = np.column_stack([A[:k, k:], b[:k]])
        left = times - A[k:, :k] @ np.linalg.solve(A[:k, :k], across)
        self._H, self._s = left[:, :-1], left[:, -1]

    def _score(self, *priors: _TimePrior) -> float:
        """Log evidence for priors of delays and steps, less their odds, [nat]."""
        mean = np.repeat([p.common for p in priors], self._sizes)
        root = block_diag(*(p.root for p in priors))
        left = root.T @ (self._s - self._H @ mean)
        A = np.eye(root.shape[1]) + root.T @ self._H @ root
        known = mean @ self._s - 0.5 * mean @ self._H @ mean
        more = 0.5 * left @ np.linalg.solve(A, left) - 0.5 * np.linalg.slogdet(A)[1]
        return float(known + more - sum(p.cost for p in priors))

    def _priors(self, size: int, steps: Sequence[float]) -> list[_TimePrior]:
        """No time, a step, the time of one joint alone, or one of each joint."""
        unit, cause = np.eye(size), self._cause
        found = [_TimePrior(0.0, unit[:, :0]), _TimePrior(size * cause, _OPEN * unit)]
        found += [_TimePrior(cause, _LINEARITY * x * unit, x) for x in steps]
        alone = (unit[:, [j]] for j in range(size))
        return found + [_TimePrior(cause, _OPEN * x) for x in alone]

    def most_probable(
        self, steps: Sequence[float], least: float
    ) -> tuple[_TimePrior, _TimePrior]:
        """The most probable priors of delays and of steps.

        A common delay is a step of the simulation, or longer than the least, [s].
        """
        latest = effect_at(Port.MEASUREMENT, shifts=True).gains[0].upper
        delays, damped = (self._priors(x, steps) for x in self._sizes)
        pairs = [(x, y) for x in delays for y in damped]
        for y in damped:
            time, _ = self.common_delay(y.common)
            if least < time < latest:
                own = _LINEARITY * time * np.eye(self._sizes[0])
                root = np.column_stack([np.full(len(own), _OPEN), own])
                pairs.append((_TimePrior(self._cause, root, time), y))
        return max(pairs, key=lambda x: self._score(*x))

    def common_delay(self, step: float) -> tuple[float, float]:
        """Delay of all torque beside a step, and its standard deviation, [s]."""
        ones = np.repeat([1.0, 0.0], self._sizes)
        more = self._H @ np.repeat([0.0, step], self._sizes)
        weight = ones @ self._H @ ones + _OPEN**-2
        return float(ones @ (self._s - more) / weight), float(weight**-0.5)

    def is_cross_validated(self) -> bool:
        """Whether delays and steps lower the held-out loss.

        An event that happens once may look like either.
        """
        every = np.arange(self._evidence.size)
        now, then = map(self._evidence.held_out_losses, (self._base, every))
        return bool(np.all(then.sum(axis=0) < now.sum(axis=0)))


def _nuisances(gap: Gap) -> list[Candidate]:
    """Effects that hide a delay: the usual ones, a scale of the log, and the body's."""
    size, kinds = gap.robot.size, effect_classes().values()
    every = [x(joints) for x in kinds if not x.usual for joints in x.places(size)]
    scales = [x for x in every if x.reports and not x.differentiates]
    body = [x for x in every if x.port is Port.BODY and x.scope == "arm"]
    return usual(gap) + [candidate(gap, x) for x in (*scales, *body)]


def _delay_columns(gap: Gap, joint: int) -> Columns:
    """Derivative of the torque of links and rotor with respect to a delay."""
    parts = []
    rotor = gap.robot.chain.armature[joint]
    for motion, body, sampler in gap:
        torque = body.load[:, joint] + rotor * motion.a[:, joint]
        parts.append(-sampler(np.gradient(torque, motion.t))[:, None])
    return {joint: np.concatenate(parts)}
