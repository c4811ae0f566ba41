"""Experiments that an arm can run safely, as reference motions within its limits."""

import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.errors import ExcitationError, HybridError, HybridWarning, RobotError
from hybrid.excitation.clearance import Clearance
from hybrid.excitation.constraints import Limits
from hybrid.excitation.experiments import (
    Walk,
    at_speeds,
    checked,
    micro_reversals,
    multisine,
    path_from_reference,
    speed_ladder,
    static_poses,
)
from hybrid.identification.preparation import STANDING
from hybrid.plant.reference import Reference, random_fourier
from hybrid.robot import Robot
from hybrid.robot.spatial import inertial_about
from hybrid.signals import Motion, Sampler

_SAME_POSTURE = 0.01  # rad or m
_TRIES = 12
_EDGE = 0.2  # s, at both ends of a motion: transient of the filter
_POSES, _FEWEST_POSES, _DRAWS = 8, 4, 60
_CHECK_RATE = 50.0  # Hz, of moves that are only checked
_SMALLER = 0.85  # amplitude of a try over that of the last
_WARM_UP = 1200.0  # s
_WARM_RISE = 20.0  # K, of the temperature of a drive
_PAYLOADS = (0.5, 0.25, 0.125)  # times the median mass of a link


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion to run, with its conditions."""

    name: str  # as it follows the word "run"
    reference: Reference
    start: float = 0.0  # time since the drives were switched on, [s]
    mass: float = 0.0  # payload at the centre of mass of the last link, [kg]
    gains: bool = False  # whether to run it with other servo gains as well

    @property
    def plain(self) -> bool:
        """Whether the motion needs no preparation."""
        return self.start == 0 and self.mass == 0 and not self.gains

    def arm(self, robot: Robot) -> Robot:
        """The arm with the payload of the experiment."""
        return with_payload(robot, self.mass) if self.mass else robot


class Menu:
    """Experiments with an arm, within 80 % of its limits and clear of its links.

    Motions are drawn by ``rng``; ``rate`` is that of the references, [Hz].
    """

    def __init__(self, robot: Robot, rng: np.random.Generator, *, rate: float) -> None:
        self._robot, self._rng, self._rate = robot, rng, rate
        self._of_joint: dict[int, tuple[Experiment, ...]] = {}
        self.limits = Limits.of(robot)

    @cached_property
    def clearance(self) -> Clearance | None:
        """Clearance of 1 cm between links; None if the file has no geometry."""
        with warnings.catch_warnings(), suppress(RobotError):
            # Links that touch in most postures are left out.
            warnings.simplefilter("ignore", HybridWarning)
            return Clearance.of(self._robot, self.limits)
        return None

    def first_safe(
        self, make: Callable[[int], Reference], robot: Robot | None = None
    ) -> Reference:
        """The first safe motion of tries from 0 on; see :meth:`checked`."""
        for k in range(_TRIES):
            try:
                return self.checked(make(k), robot)
            except ExcitationError as error:
                failed = error
        raise failed

    def checked(self, reference: Reference, robot: Robot | None = None) -> Reference:
        """The reference, if it is safe for the arm, which may have a payload.

        Raises:
            ExcitationError: A limit is exceeded, or two links come too close.
        """
        checked(robot or self._robot, reference, self.limits)
        if self.clearance is None or not len(self.clearance.pairs):
            return reference
        postures = np.round(reference.q / _SAME_POSTURE)
        _, first = np.unique(postures, axis=0, return_index=True)
        worst = self.clearance.excess(path_from_reference(reference).at(first))
        if (worst > 0).any():
            name = self.clearance.names[int(worst.max(axis=0).argmax())]
            raise ExcitationError(f"{name}; valid is a motion with more room")
        return reference

    def about(self, joint: int) -> tuple[Experiment, ...]:
        """Experiments that move a joint."""
        if joint not in self._of_joint:
            name = f"small reversals of {self._robot.joints[joint]}"
            small = self._if_safe(name, self._of_one(micro_reversals, joint))
            self._of_joint[joint] = (*self.ladder(joint, longest=2.0), *small)
        return (*self._of_joint[joint], *self.of_all_joints)

    def ladder(self, joint: int, *, longest: float = 4.0) -> tuple[Experiment, ...]:
        """Motions of a joint at many speeds, each for ``longest`` s at most."""
        name = f"a ladder of speeds of {self._robot.joints[joint]}, up and down"
        return self._if_safe(name, self._of_one(speed_ladder, joint, longest=longest))

    @cached_property
    def of_all_joints(self) -> tuple[Experiment, ...]:
        """Experiments that move all joints."""
        robot, rate, path = self._robot, self._rate, self._path
        return (
            *self._if_safe(
                "one path of all joints at 0.5, 1 and 2 times its speed",
                lambda k: concatenated(at_speeds(robot, path(10.0, 0.2, k))),
            ),
            *self._if_safe(
                "moves between poses all over the workspace, with a rest in each",
                lambda _: static_poses(robot, self._poses(), hold=0.5, rate=rate),
            ),
            *self._if_safe("a multisine of all joints from 0.2 to 5 Hz", self._tones),
            *self._if_safe(
                "a fast random motion of all joints over most of their range",
                lambda k: path(20.0, 0.8, k),
            ),
            *self._prepared(),
        )

    def _prepared(self) -> tuple[Experiment, ...]:
        """Experiments that need preparation: warm drives, other gains or a payload."""
        warm = (
            "a random motion of all joints again when the drives are warm, after "
            f"{_WARM_UP / 60:.0f} minutes of work, logged by the same clock"
        )
        twice = (
            "a random motion of all joints twice, the second time with the gains of "
            "the servo at half"
        )
        found = (
            *self._if_safe(warm, self._random, start=_WARM_UP),
            *self._if_safe(twice, self._random, gains=True),
        )
        for part in _PAYLOADS:
            mass = float(f"{part * np.median(self._robot.chain.inertial[:, 0]):.1g}")
            carry = (
                f"a random motion of all joints with a known mass of {mass:g} kg at "
                "the last link, and diagnose that recording alone, with the mass in "
                "the simulator's file"
            )
            if mass > 0 and (heavy := self._if_safe(carry, self._random, mass=mass)):
                return (*found, *heavy)
        return found

    def _if_safe(
        self, name: str, make: Callable[[int], Reference], **conditions: Any
    ) -> tuple[Experiment, ...]:
        """The experiment, if the arm has enough room, speed and torque for it."""
        mass = conditions.get("mass")
        arm = with_payload(self._robot, mass) if mass else self._robot
        try:
            return (Experiment(name, self.first_safe(make, arm), **conditions),)
        except HybridError:
            return ()

    def _of_one(
        self, make: Callable[..., Reference], joint: int, **more: float
    ) -> Callable[[int], Reference]:
        """Tries of a motion of one joint, each in another posture."""
        # Motions take a joint by its name, or by its number from 1 as text.
        one = partial(make, self._robot, str(joint + 1), rate=self._rate, **more)
        return lambda k: one(posture=self._posture(k))

    def _tones(self, k: int) -> Reference:
        fill, posture = 0.5 * _SMALLER**k, self._posture(k)
        return multisine(
            self._robot, fill=fill, posture=posture, seed=self._rng, rate=self._rate
        )

    def _random(self, k: int) -> Reference:
        return self._path(20.0, 0.6, k)

    def _path(self, duration: float, fill: float, k: int) -> Reference:
        """A random motion, smaller with each try ``k``."""
        return random_fourier(
            self._robot,
            duration=duration,
            rate=self._rate,
            seed=self._rng,
            fill=fill * _SMALLER**k,
            fundamental=0.1,
        )

    def _posture(self, k: int) -> Array | None:
        """The middle of the range in the first try, then random postures."""
        return self._random_posture(0.6) if k else None

    def _random_posture(self, part: float) -> Array:
        """A random posture within a part of the range about its middle."""
        x = self.limits
        offset = part * self._rng.uniform(-1, 1, self._robot.size)
        return np.asarray((x.low + x.high + offset * (x.high - x.low)) / 2)

    def _poses(self) -> Array:
        """Poses with safe straight moves from each to the next, and to the first."""
        first = self.first_safe(
            lambda k: self._move(self._random_posture(0.6 if k else 0.0))
        )
        poses = [first.q[0]]
        for _ in range(_DRAWS):
            goal = self._random_posture(0.85)
            try:
                self.checked(self._move(poses[-1], goal))
                self.checked(self._move(goal, poses[0]))
            except HybridError:
                continue
            poses.append(goal)
            if len(poses) == _POSES:
                break
        if len(poses) < _FEWEST_POSES:
            raise HybridError("too few poses can be reached safely")
        return np.array([*poses, poses[0]])

    def _move(self, *poses: Array) -> Reference:
        walk = Walk(poses[0])
        for goal in poses[1:]:
            walk.move(goal, self.limits)
        walk.wait(0.1)
        return walk.reference(_CHECK_RATE)


def with_payload(robot: Robot, mass: float) -> Robot:
    """The arm with a payload at the centre of mass of its last link, [kg]."""
    inertial = robot.chain.inertial.copy()
    center = inertial[-1, 1:4] / max(inertial[-1, 0], 1e-9)
    inertial[-1] += inertial_about(mass, center, np.zeros((3, 3)))
    return robot.with_inertial(inertial)


def gap_along(gap: Gap, experiment: Experiment) -> Gap:
    """A gap of zero along an experiment, to compute columns of effects there.

    The arm is assumed to follow it exactly. It has the clock, the cut-off and the rate
    of ``gap``, a measured one, so that noise has the same meaning.
    """
    r, robot = experiment.reference, experiment.arm(gap.robot)
    rate = gap.motions[0].rate
    t = np.arange(0.0, r.t[-1], 1.0 / rate)
    q, v = r.at(t)
    a = np.column_stack([np.interp(t, r.t, x) for x in r.a.T])
    edge, mask = round(_EDGE * rate), np.zeros(len(t), dtype=bool)
    mask[edge:-edge] = True
    temperature, logged = None, gap.sampled.temperature
    if logged is not None:
        warm = logged.max(axis=0) + _WARM_RISE
        level = warm if experiment.start else logged.min(axis=0)
        temperature = np.tile(level, (len(t), 1))
    t = experiment.start + t
    motion = Motion(t, q, v, a, 0 * q, mask, temperature, robot.joints)
    body = RigidBody(robot.chain, motion)
    motion = replace(motion, tau=simulated_torque(robot, motion, body))
    keep = Sampler.for_rate(rate, gap.cutoff).keep
    moving = np.abs(keep(v)) > STANDING * np.abs(gap.sampled.v).max(axis=0)
    moving &= keep(mask)[:, None]
    zero, left = np.zeros(len(moving), dtype=np.intp), np.zeros(moving.shape)
    return Gap(robot, (motion,), (body,), gap.cutoff, gap.period, left, moving,
               zero, zero)  # fmt: skip


def concatenated(references: Sequence[Reference]) -> Reference:
    """References one after the other; each ends at rest where the next one starts."""
    whole = references[0]
    for r in references[1:]:
        t = np.append(whole.t, whole.t[-1] + r.t[1:])
        pairs = ((whole.q, r.q), (whole.v, r.v), (whole.a, r.a))
        whole = Reference(t, *(np.concatenate([x, y[1:]]) for x, y in pairs))
    return whole
