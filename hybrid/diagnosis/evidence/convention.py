"""How a simulation's log was written: which instant its torque is of.

A loop that steps and then logs writes the position after a step beside the torque of
the instant before it. And an implicit step feels a servo's damping at the speed that
it arrives at, while the torque it reports is that of the speed it left from: over a
step h the report is too high by ``h k_d a``. Both are the log's, not the arm's, and are
taken back where nothing else is more probable (MacKay 1992, doi
10.1162/neco.1992.4.3.415). So is torque that is late by a time which is no step, as if
stamped by another clock; but that is a cause, and is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import candidate
from hybrid.diagnosis.evidence.estimate import estimate_noise
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.gap.background import background, rest
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.diagnosis.prior import Prior
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.payload import Payload
from hybrid.effects.torque_gain import TorqueGain
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.identification.preparation import FEWEST_PERIODS
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion

_BESIDE = (Viscous, Coulomb, TorqueOffset, TorqueGain)
_LOWER = 0.5  # of the cut-off: noise of positions grows with the cube of frequency
_OPEN = 0.1  # s, one standard deviation of an age, and of a damping's step
_ALIKE = 0.1  # of a time that joints share, by which columns of first order are off
_LATEST = Delay.gains[0].upper  # s


@dataclass(frozen=True)
class Convention:
    """How torque was logged.

    Attributes:
        late: Torque is of so much before the position, [s].
        step: Step h over which the report leaves out the servo's damping, [s].
        std: Standard deviation of ``late``, [s], if it is no step of a loop but a
            cause: torque and position stamped by different clocks.
    """

    late: float = 0.0
    step: float = 0.0
    std: float = 0.0

    def __bool__(self) -> bool:
        return self.late > 0 or self.step > 0

    @property
    def clocks(self) -> bool:
        """Whether torque is late by a time that is no step of a loop."""
        return self.std > 0

    def in_step(self, log: Recording | Motion) -> Recording | Motion:
        """A log with the torque, and the command, of the instant of each position."""
        if not self.late:
            return log
        # Which clock stamps commands is not known.
        if isinstance(log, Motion) or log.command is None or self.clocks:
            return replace(log, tau=self._later(log.t, log.tau))
        command = self._later(log.t, log.command)
        return replace(log, tau=self._later(log.t, log.tau), command=command)

    def _later(self, t: Array, x: Array) -> Array:
        """Samples of a later time; those of the end, which has none, as they are."""
        then = t + self.late
        moved = np.stack([np.interp(then, t, y) for y in x.T], axis=1)
        return np.where((then > t[-1])[:, None], x, moved)

    def explicit(self, robot: Robot, motion: Motion) -> Motion:
        """A motion with the torque, and the speed of friction, that acted in a step.

        Less the end that has no torque, if it is late.
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
        """What was taken back, in words."""
        found = []
        if self.clocks:
            found.append(
                f"torque is logged {1e3 * self.late:.3g} ms late at every joint: what "
                "else is said is of the log without that"
            )
        elif self.late:
            found.append(
                f"torque is logged {1e3 * self.late:.3g} ms late at every joint, as by "
                "a simulation that steps before it logs: taken back"
            )
        if self.step:
            found.append(
                "torque is logged with the servo's damping at the start of an implicit "
                f"step of {1e3 * self.step:.3g} ms: taken back"
            )
        return tuple(found)


def find_convention(
    gap: Gap, recordings: Sequence[Recording | Motion], *, clocks: bool = True
) -> Convention:
    """The most probable of the few ways in which a loop may log.

    Torque of each joint has an age, and a servo's torque is of a step before: none of
    either, that of one joint alone, of each joint its own, or what all of them share.

    Args:
        gap: The gap with the log taken at its word.
        recordings: What it was measured from.
        clocks: Whether torque and position may be stamped by different clocks.
    """
    robot = gap.robot
    shortest = min(float(m.t[-1] - m.t[0]) for m in gap.motions)
    lower = max(_LOWER * gap.cutoff, FEWEST_PERIODS / shortest)
    measured = partial(measure_gap, robot, cutoff=lower)
    gap = measured(recordings)
    if not gap.moving.any():
        return Convention()
    steps = sorted(x for x in {1.0 / gap.motions[0].rate, robot.timestep} if x > 0)
    asked = _Asked(gap)
    # Within a sample nobody knows when torque was read.
    least = 1.0 / gap.motions[0].rate if clocks else _LATEST
    age, damped = asked.most_probable(steps, least)
    late, step = age.shared, damped.shared
    if not (late or step) or not asked.hold():
        return Convention()
    if not late or late in steps:
        return Convention(late, step)
    # That took torque to change evenly over the time; what is left of it is small.
    shift = Convention(late, step, asked.shared(step)[1])
    shifted = measured([shift.in_step(x) for x in recordings])
    more, std = _Asked(shifted).shared(step)
    return Convention(late + more, step, std)


@dataclass(frozen=True)
class _Guess:
    """What may be of some times, one of each joint, [s].

    Attributes:
        cost: Odds against it, [nat].
        root: A root of their covariance, shape (p, k).
        shared: What all of them are about, or zero.
    """

    cost: float
    root: Array
    shared: float = 0.0


class _Asked:
    """Evidence for the age of each joint's torque, and for its servo's step.

    Args:
        gap: The gap, of the lower band.
    """

    def __init__(self, gap: Gap) -> None:
        robot, prior = gap.robot, Prior()
        joints = [j for j in range(robot.size) if gap.moving[:, j].any()]
        servo = [j for j in joints if robot.kd[j] > 0]
        evidence, self._cause = Evidence(gap), prior.cause
        numbers = np.concatenate(evidence.add(*background(gap)))
        evidence.spread(numbers, prior.file[0])
        evidence.add(*rest(gap))
        beside = [candidate(gap, kind((j,))) for kind in _BESIDE for j in joints]
        # A rotor that the file lacks is no age of torque.
        rotors = set(joints) - set(servo)
        beside += [candidate(gap, Armature((j,))) for j in rotors]
        beside.append(candidate(gap, Payload(tuple(range(robot.size)))))
        evidence.add([gap.columns(c.effect) for c in beside], [c.std for c in beside])
        self._base = np.arange(evidence.size)
        damped = [{j: robot.kd[j] * gap.columns(Armature((j,)))[j]} for j in servo]
        ages = [_older(gap, j) for j in joints]
        open_ = [np.array([_OPEN])] * len(joints + servo)
        evidence.add([*ages, *damped], open_)
        self._evidence, self._sizes = evidence, (len(joints), len(servo))
        every = np.arange(evidence.size)
        estimate_noise(evidence, every)
        A, b = evidence.normal(every)
        k = len(self._base)
        A[:k, :k] += np.diag(evidence.precision[:k])
        asked = np.column_stack([A[k:, k:], b[k:]])
        known = np.column_stack([A[:k, k:], b[:k]])
        left = asked - A[k:, :k] @ np.linalg.solve(A[:k, :k], known)
        self._H, self._s = left[:, :-1], left[:, -1]

    def _worth(self, *guesses: _Guess) -> float:
        """Evidence for what ages and steps may be, [nat]."""
        mean = np.repeat([g.shared for g in guesses], self._sizes)
        root = block_diag(*(g.root for g in guesses))
        left = root.T @ (self._s - self._H @ mean)
        A = np.eye(root.shape[1]) + root.T @ self._H @ root
        known = mean @ self._s - 0.5 * mean @ self._H @ mean
        more = 0.5 * left @ np.linalg.solve(A, left) - 0.5 * np.linalg.slogdet(A)[1]
        return float(known + more - sum(g.cost for g in guesses))

    def _guesses(self, size: int, steps: Sequence[float]) -> list[_Guess]:
        """Nothing, a step, the time of one joint alone, or of each its own."""
        unit = np.eye(size)
        found = [_Guess(0.0, unit[:, :0]), _Guess(size * self._cause, _OPEN * unit)]
        found += [_Guess(self._cause, _ALIKE * x * unit, x) for x in steps]
        alone = (unit[:, [j]] for j in range(size))
        return found + [_Guess(self._cause, _OPEN * x) for x in alone]

    def most_probable(
        self, steps: Sequence[float], least: float
    ) -> tuple[_Guess, _Guess]:
        """What ages and steps most probably are.

        Args:
            steps: Those of the loop, [s].
            least: Shortest time that all torque may be late by besides, [s].
        """
        ages, damped = (self._guesses(x, steps) for x in self._sizes)
        pairs = [(x, y) for x in ages for y in damped]
        for y in damped:
            time, _ = self.shared(y.shared)
            if least < time < _LATEST:
                own = _ALIKE * time * np.eye(self._sizes[0])
                root = np.column_stack([np.full(len(own), _OPEN), own])
                pairs.append((_Guess(self._cause, root, time), y))
        return max(pairs, key=lambda x: self._worth(*x))

    def shared(self, step: float) -> tuple[float, float]:
        """Time that all torque is late by beside a step, and its deviation, [s]."""
        ones = np.repeat([1.0, 0.0], self._sizes)
        more = self._H @ np.repeat([0.0, step], self._sizes)
        weight = ones @ self._H @ ones + _OPEN**-2
        return float(ones @ (self._s - more) / weight), float(weight**-0.5)

    def hold(self) -> bool:
        """Whether ages and steps found on other folds lower the squares there.

        What happens once may look like either.
        """
        every = np.arange(self._evidence.size)
        now, then = map(self._evidence.left_out, (self._base, every))
        return bool(np.all(then < now))


def _older(gap: Gap, joint: int) -> Columns:
    """Change of the torque of links and rotor with its age, per second."""
    parts = []
    rotor = gap.robot.chain.armature[joint]
    for motion, body, sampler in gap:
        torque = body.load[:, joint] + rotor * motion.a[:, joint]
        parts.append(-sampler(np.gradient(torque, motion.t))[:, None])
    return {joint: np.concatenate(parts)}
