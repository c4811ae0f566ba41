"""How a simulation's log was written: which instant its torque is of.

A loop that steps and then logs writes the position after a step beside the torque of
the instant before it. And an implicit step feels a servo's damping at the speed that
it arrives at, while the torque it reports is that of the speed it left from: over a
step h the report is too high by ``h k_d a``. Both are the log's, not the arm's, and are
taken back where most joints agree on them. So is torque that is late by a time which is
no step, as if stamped by another clock; but that is a cause, and is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.candidates import Candidate, candidate
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.products import Index
from hybrid.diagnosis.gap.background import background, rest
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.payload import Payload
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.viscous import Viscous
from hybrid.identification.preparation import FEWEST_PERIODS
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals import Motion

_BESIDE = (Viscous, Coulomb, TorqueOffset)
_LOWER = 0.5  # of the cut-off: noise of positions grows with the cube of frequency
_OFF = 0.01  # one standard deviation of the background, relative
_OPEN = 0.1  # s, and seconds of a servo's damping: the same of what is asked for
_TELLING = 0.2  # standard deviation of a joint's answer, of what it may be
_AGREES = 0.5  # of what it may be
_FEWEST, _MOST = 2, 0.6  # of the joints that tell, at least; and that part
_NEAR = 0.15  # of a time that all joints share; a step that is farther off is not it
_SURE = 4.0  # standard deviations
_PROMPT = 1e-3  # s; less than that, or than most of a sample, no log is late by
_OFTEN = 0.8  # of the folds
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
    """What most joints agree on, of the few ways in which a loop may log.

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
    joints = [j for j in range(robot.size) if gap.moving[:, j].any()]
    if not joints:
        return Convention()
    steps = sorted(x for x in {1.0 / gap.motions[0].rate, robot.timestep} if x > 0)
    kd = np.where(robot.kd > 0, robot.kd, 0.0)[joints]
    late = step = 0.0
    for loaded in (False, True):
        ages, rotors = _answers(gap, joints, kd, loaded)
        late = late or _agreed(*ages, steps)
        step = step or _agreed(*rotors, steps)
    if step and _carries(gap, joints):
        step = 0.0
    found = Convention(late, step)
    time, std = _shared(*ages) if clocks else (0.0, 0.0)
    least = max(_PROMPT, (1.0 - _NEAR) / gap.motions[0].rate)
    usual = any(abs(time - x) < max(_SURE * std, _NEAR * x) for x in steps)
    if not least < time < _LATEST or usual or not _holds(gap, joints, kd):
        return found
    # That took torque to change evenly over the time; what is left of it is small.
    shift = Convention(time, step, std)
    shifted = measured([shift.in_step(x) for x in recordings])
    (left, own), _ = _answers(shifted, joints, kd, loaded=True)
    more, std = _mean(left, own)
    return Convention(time + more, step, std)


def _carries(gap: Gap, joints: Sequence[int]) -> bool:
    """Whether something that the arm carries explains more than an implicit step."""
    evidence, rigid, found = _beside(gap, joints)
    found.append(candidate(gap, Payload(tuple(range(gap.robot.size)))))
    damped = {
        j: gap.robot.kd[j] * gap.columns(Armature((j,)))[j]
        for j in joints if gap.robot.kd[j] > 0
    }  # fmt: skip
    blocks = [*(gap.columns(c.effect) for c in found), damped]
    *others, load, step = evidence.add(
        blocks, [*(c.std for c in found), np.array([_OPEN])]
    )
    evidence.estimate_noise(np.arange(evidence.size))
    base = np.concatenate([rigid, *others])
    carried, stepped = (
        evidence.solve(np.concatenate([base, x])).evidence for x in (load, step)
    )
    return carried > stepped


def _beside(gap: Gap, joints: Sequence[int]) -> tuple[Evidence, Index, list[Candidate]]:
    """Evidence with the background in it, and effects that may be there as well."""
    evidence = Evidence(gap)
    numbers = np.concatenate(evidence.add(*background(gap)))
    evidence.spread(numbers, _OFF)
    rigid = np.concatenate([numbers, *evidence.add(*rest(gap))])
    found = [candidate(gap, kind((j,))) for kind in _BESIDE for j in joints]
    return evidence, rigid, found


def _answers(
    gap: Gap, joints: Sequence[int], kd: Array, loaded: bool
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Age of each joint's torque, and its extra rotor over its servo's damping, [s].

    Args:
        gap: The gap.
        joints: The joints that move.
        kd: Damping of their servos, shape (J,), [N·m·s/rad]; zero without one.
        loaded: Whether the arm may carry something unknown.

    Returns:
        Values and standard deviations of both.
    """
    evidence, own = _asked(gap, joints, kd, loaded)
    found = evidence.solve(np.arange(evidence.size))
    value, std = found.gains[own], np.sqrt(np.diag(found.covariance)[own])
    n, kd = len(joints), kd[kd > 0]
    return (value[:n], std[:n]), (value[n:] / kd, std[n:] / kd)


def _holds(gap: Gap, joints: Sequence[int], kd: Array) -> bool:
    """Whether ages of torque found on other folds lower the squares of most of them.

    What happens once may look like an age.
    """
    evidence, own = _asked(gap, joints, kd, loaded=True)
    every, ages = np.arange(evidence.size), own[: len(joints)]
    left = [
        (evidence.squares(x, evidence.by_fold(x)) / evidence.noise[:, None]).sum(axis=0)
        for x in (np.setdiff1d(every, ages), every)
    ]
    return bool(np.mean(left[1] < left[0]) >= _OFTEN)


def _asked(
    gap: Gap, joints: Sequence[int], kd: Array, loaded: bool
) -> tuple[Evidence, Index]:
    """Evidence for ages and rotors beside all else, and their columns."""
    robot, (evidence, _, beside) = gap.robot, _beside(gap, joints)
    servo = [j for j, k in zip(joints, kd, strict=True) if k > 0]
    # A rotor that the file lacks is no age of torque.
    beside += [candidate(gap, Armature((j,))) for j in joints if j not in servo]
    kd = kd[kd > 0]
    if loaded:
        beside.append(candidate(gap, Payload(tuple(range(robot.size)))))
    evidence.add([gap.columns(c.effect) for c in beside], [c.std for c in beside])
    asked = [_older(gap, j) for j in joints]
    asked += [gap.columns(Armature((j,))) for j in servo]
    open_ = np.array([*np.full(len(joints), _OPEN), *(_OPEN * kd)])
    own = np.concatenate(evidence.add(asked, list(open_[:, None])))
    evidence.estimate_noise(np.arange(evidence.size))
    return evidence, own


def _older(gap: Gap, joint: int) -> Columns:
    """Change of the torque of links and rotor with its age, per second."""
    parts = []
    rotor = gap.robot.chain.armature[joint]
    for motion, body, sampler in gap:
        torque = body.load[:, joint] + rotor * motion.a[:, joint]
        parts.append(-sampler(np.gradient(torque, motion.t))[:, None])
    return {joint: np.concatenate(parts)}


def _agreed(value: Array, std: Array, steps: Sequence[float]) -> float:
    """Which of some times most joints that can tell agree on; zero if none."""
    for step in steps:
        telling = std < _TELLING * step
        agree = telling & (np.abs(value - step) < _AGREES * step)
        if agree.sum() >= max(_FEWEST, _MOST * telling.sum()):
            return step
    return 0.0


def _shared(value: Array, std: Array) -> tuple[float, float]:
    """A time that all joints share which can tell, and its deviation, [s].

    Zero if they are late by different times, or not surely late.
    """
    time, spread = _mean(value, std)
    telling = std < _TELLING * abs(time)
    off = np.abs(value - time) < np.maximum(_SURE * std, _NEAR * time)
    few = telling.sum() < min(_FEWEST + 1, len(value)) or len(value) < _FEWEST
    if few or time < _SURE * spread or not off[telling].all():
        return 0.0, 0.0
    return time, spread


def _mean(value: Array, std: Array) -> tuple[float, float]:
    """Mean by certainty, and its standard deviation."""
    weight = std**-2.0
    return float(weight @ value / weight.sum()), float(weight.sum() ** -0.5)
