"""A safe menu: experiments that an arm can run, as references within its limits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.advice.envelope import Envelope
from hybrid.diagnosis.gap.gap import Gap, simulated_torque
from hybrid.dynamics import RigidBody
from hybrid.errors import HybridError
from hybrid.excitation.experiments import (
    at_speeds,
    micro_reversals,
    multisine,
    speed_ladder,
    static_poses,
)
from hybrid.excitation.knots import Walk
from hybrid.identification.preparation import STANDING
from hybrid.plant.reference import Reference, random_fourier
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler

_EDGE = 0.2  # s, at both ends of a motion, that filters spoil
_CUTOFF = 30.0  # Hz, of what is expected of experiments; none is that fast
_CLOCK = 5.0  # samples per period of the cut-off
_POSES, _FEWEST_POSES, _DRAWS = 8, 4, 60
_PREVIEW = 50.0  # Hz, of moves that are only checked
_SMALLER = 0.85  # from one try to the next
_WARM = 1200.0  # s, after which a drive is warm
_WARMER = 20.0  # K, by then
_LIGHTER = (0.5, 0.25, 0.125)  # of a middling link, to be carried


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion to run, and when and with what.

    Attributes:
        name: What it is, as the words after "run".
        reference: The motion.
        start: Time since the drives were switched on, [s].
        mass: What the last link carries, at its centre of mass, [kg].
        gains: Whether it is to be run with other gains of the servo as well.
    """

    name: str
    reference: Reference
    start: float = 0.0
    mass: float = 0.0
    gains: bool = False

    @property
    def plain(self) -> bool:
        """Whether it takes no more than to run the motion."""
        return self.start == 0 and self.mass == 0 and not self.gains

    def arm(self, robot: Robot) -> Robot:
        """The arm as it is in the experiment."""
        return loaded(robot, self.mass) if self.mass else robot


class Menu:
    """Experiments about an arm, as far as its limits and its links allow them.

    Args:
        robot: The arm.
        rng: Source of random motions.
        rate: Samples of the references per second, [Hz].
    """

    def __init__(self, robot: Robot, rng: np.random.Generator, *, rate: float) -> None:
        self._robot, self._rng, self._rate = robot, rng, rate
        self._of_joint: dict[int, tuple[Experiment, ...]] = {}

    def about(self, joint: int) -> tuple[Experiment, ...]:
        """Experiments that tell something about a joint."""
        if joint not in self._of_joint:
            # A number from 1, as text, is the one name no joint can be taken for.
            robot, rate, number = self._robot, self._rate, str(joint + 1)

            def reversals(k: int) -> Reference:
                posture = self._posture(k)
                return micro_reversals(robot, number, rate=rate, posture=posture)

            small = self._served(f"small reversals of {robot.joints[joint]}", reversals)
            self._of_joint[joint] = (*self.ladder(joint, longest=2.0), *small)
        return (*self._of_joint[joint], *self.of_all_joints)

    @cached_property
    def envelope(self) -> Envelope:
        """What the arm may do."""
        return Envelope.of(self._robot)

    def ladder(self, joint: int, *, longest: float = 4.0) -> tuple[Experiment, ...]:
        """A joint forth and back at many speeds, if there is room for it.

        Args:
            joint: The joint.
            longest: Longest time at one speed, [s].
        """
        robot, rate, number = self._robot, self._rate, str(joint + 1)

        def make(k: int) -> Reference:
            posture = self._posture(k)
            return speed_ladder(
                robot, number, longest=longest, rate=rate, posture=posture
            )

        name = f"a ladder of speeds of {robot.joints[joint]}, up and down"
        return self._served(name, make)

    @cached_property
    def of_all_joints(self) -> tuple[Experiment, ...]:
        """Experiments that move all joints."""
        robot, rng, rate = self._robot, self._rng, self._rate

        def speeds(k: int) -> Reference:
            return joined(at_speeds(robot, self._path(10.0, 0.2, k)))

        def poses(_: int) -> Reference:
            return static_poses(robot, self._poses(), hold=0.5, rate=rate)

        def tones(k: int) -> Reference:
            fill, posture = 0.5 * _SMALLER**k, self._posture(k)
            return multisine(robot, fill=fill, posture=posture, seed=rng, rate=rate)

        return (
            *self._served(
                "one path of all joints at 0.5, 1 and 2 times its speed", speeds
            ),
            *self._served(
                "moves between poses all over the workspace, with a rest in each", poses
            ),
            *self._served("a multisine of all joints from 0.2 to 5 Hz", tones),
            *self._served(
                "a fast random motion of all joints over most of their range",
                lambda k: self._path(20.0, 0.8, k),
            ),
            *self._with_hands(),
        )

    def _with_hands(self) -> tuple[Experiment, ...]:
        """Experiments for which something has to be prepared."""
        found = (
            *self._served(
                "a random motion of all joints again when the drives are warm, after "
                f"{_WARM / 60:.0f} minutes of work, logged by the same clock",
                self._random,
                start=_WARM,
            ),
            *self._served(
                "a random motion of all joints twice, the second time with the gains "
                "of the servo at half",
                self._random,
                gains=True,
            ),
        )
        for part in _LIGHTER:
            mass = float(f"{part * np.median(self._robot.chain.inertial[:, 0]):.1g}")
            carry = (
                f"a random motion of all joints with a known mass of {mass:g} kg at "
                "the last link, and diagnose that recording alone, with the mass in "
                "the simulator's file"
            )
            if mass > 0 and (heavy := self._served(carry, self._random, mass=mass)):
                return (*found, *heavy)
        return found

    def _served(
        self,
        name: str,
        make: Callable[[int], Reference],
        *,
        start: float = 0.0,
        mass: float = 0.0,
        gains: bool = False,
    ) -> tuple[Experiment, ...]:
        """An experiment; nothing if the arm has no room, speed or torque for it."""
        arm = loaded(self._robot, mass) if mass else self._robot
        try:
            reference = self.envelope.first_safe(make, arm)
        except HybridError:
            return ()
        return (Experiment(name, reference, start, mass, gains),)

    def _random(self, k: int) -> Reference:
        return self._path(20.0, 0.6, k)

    def _path(self, duration: float, fill: float, k: int) -> Reference:
        """A random motion, smaller from try to try."""
        return random_fourier(
            self._robot,
            duration=duration,
            rate=self._rate,
            seed=self._rng,
            fill=fill * _SMALLER**k,
            fundamental=0.1,
        )

    def _posture(self, k: int) -> Array | None:
        """The middle of the range at first, and then any posture about it."""
        return self._anywhere(0.6) if k else None

    def _anywhere(self, part: float) -> Array:
        x = self.envelope.limits
        away = part * self._rng.uniform(-1, 1, self._robot.size)
        return np.asarray((x.low + x.high + away * (x.high - x.low)) / 2)

    def _poses(self) -> Array:
        """Poses between which the arm can go straight, back to the first one too."""
        first = self.envelope.first_safe(
            lambda k: self._move(self._anywhere(0.6 if k else 0.0))
        )
        poses = [first.q[0]]
        for _ in range(_DRAWS):
            goal = self._anywhere(0.85)
            try:
                self.envelope.checked(self._move(poses[-1], goal))
                self.envelope.checked(self._move(goal, poses[0]))
            except HybridError:
                continue
            poses.append(goal)
            if len(poses) == _POSES:
                break
        if len(poses) < _FEWEST_POSES:
            raise HybridError("too few poses can be reached safely")
        return np.array([*poses, poses[0]])  # so that it can be run again

    def _move(self, *poses: Array) -> Reference:
        walk = Walk(poses[0])
        for goal in poses[1:]:
            walk.move(goal, self.envelope.limits)
        walk.wait(0.1)
        return walk.reference(_PREVIEW)


def loaded(robot: Robot, mass: float) -> Robot:
    """An arm that carries a mass at the centre of mass of its last link, [kg]."""
    inertial = robot.chain.inertial.copy()
    x, y, z = inertial[-1, 1:4] / max(inertial[-1, 0], 1e-9)
    squares = [y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y]
    inertial[-1] += mass * np.array([1.0, x, y, z, *squares])
    return robot.with_inertial(inertial)


def gap_along(gap: Gap, experiment: Experiment) -> Gap:
    """What a gap would be along an experiment without any gap: all zeros.

    Args:
        gap: A gap that was measured, for the simulator and its speeds.
        experiment: The experiment, taken to be followed perfectly.
    """
    cutoff = min(gap.cutoff, _CUTOFF)
    r, robot = experiment.reference, experiment.arm(gap.robot)
    step = max(1, int(r.rate / (_CLOCK * cutoff)))
    q, v, a = (x[::step] for x in (r.q, r.v, r.a))
    edge, mask = round(_EDGE * r.rate / step), np.zeros(len(q), dtype=bool)
    mask[edge:-edge] = True
    warmth, logged = None, gap.sampled.temperature
    if logged is not None:
        warm = logged.max(axis=0) + _WARMER if experiment.start else logged.min(axis=0)
        warmth = np.broadcast_to(warm, q.shape).copy()
    t = experiment.start + r.t[::step]
    motion = Motion(t, q, v, a, 0 * q, mask, warmth, robot.joints)
    body = RigidBody(robot.chain, motion)
    motion = replace(motion, tau=simulated_torque(robot, motion, body))
    sampler = Sampler.for_rate(motion.rate, cutoff)
    v = v[:: sampler.factor]
    moving = np.abs(v) > STANDING * np.abs(gap.sampled.v).max(axis=0)
    moving &= sampler.keep(mask)[:, None]
    of, left = np.zeros(len(v), dtype=np.intp), np.zeros_like(v)
    return Gap(robot, (motion,), (body,), cutoff, left, moving, of, of)


def joined(references: Sequence[Reference]) -> Reference:
    """References that end where the next one starts, at rest, one after the other."""
    whole = references[0]
    for r in references[1:]:
        t = np.append(whole.t, whole.t[-1] + r.t[1:])
        pairs = ((whole.q, r.q), (whole.v, r.v), (whole.a, r.a))
        whole = Reference(t, *(np.concatenate([x, y[1:]]) for x, y in pairs))
    return whole
