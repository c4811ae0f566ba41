"""A safe menu: experiments that an arm can run, as references within its limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.diagnose.gap import Gap, simulated_torque
from hybrid.dynamics import RigidBody
from hybrid.errors import HybridError
from hybrid.excitation.experiments import (
    at_speeds,
    micro_reversals,
    multisine,
    speed_ladder,
    static_poses,
)
from hybrid.plant.reference import Reference, limits, random_fourier
from hybrid.robot import Robot
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler

_EDGE = 0.2  # s, at both ends of a motion, that filters spoil
_STANDING = 0.01  # of the highest speed
_POSES = 8
_WARM = 1200.0  # s, after which a drive is warm


@dataclass(frozen=True, eq=False)
class Experiment:
    """A motion to run, and when.

    Attributes:
        name: What it is, as the words after "run".
        reference: The motion.
        start: Time since the drives were switched on, [s].
    """

    name: str
    reference: Reference
    start: float = 0.0


def menu(
    robot: Robot, joint: int, rng: np.random.Generator, *, rate: float
) -> Iterator[Experiment]:
    """Experiments about one joint, as far as the arm's limits allow them.

    Args:
        robot: The arm.
        joint: The joint.
        rng: Source of random motions.
        rate: Samples of the references per second, [Hz].
    """
    name = robot.joints[joint]

    def path(duration: float, fill: float) -> Reference:
        return random_fourier(
            robot, duration=duration, rate=rate, rng=rng, fill=fill, fundamental=0.1
        )

    number = joint_number(joint)
    dishes: tuple[tuple[str, Callable[[], Reference], float], ...] = (
        ("one path of all joints at 0.5, 1 and 2 times its speed",
         lambda: joined(at_speeds(robot, path(10.0, 0.2), (0.5, 1.0, 2.0))), 0.0),
        (f"a ladder of speeds of {name}, up and down",
         lambda: speed_ladder(robot, number, longest=2.0, rate=rate), 0.0),
        (f"small reversals of {name}",
         lambda: micro_reversals(robot, number, rate=rate), 0.0),
        ("moves between poses all over the workspace, with a rest in each",
         lambda: static_poses(robot, _poses(robot, rng), hold=0.5, rate=rate), 0.0),
        ("a multisine of all joints from 0.2 to 5 Hz",
         lambda: multisine(robot, rng=rng, rate=rate), 0.0),
        ("a fast random motion of all joints over most of their range",
         lambda: path(20.0, 0.8), 0.0),
        ("a random motion of all joints again when the drives are warm, after "
         f"{_WARM / 60:.0f} minutes of work, logged by the same clock",
         lambda: path(20.0, 0.6), _WARM),
    )  # fmt: skip
    for text, make, start in dishes:
        try:
            yield Experiment(text, make(), start)
        except HybridError:
            continue  # this arm has no room, speed or torque for it


def joint_number(joint: int) -> str:
    """A joint's number from 1, as text, which no name can be mistaken for."""
    return str(joint + 1)


def gap_along(gap: Gap, experiment: Experiment) -> Gap:
    """What a gap would be along an experiment without any gap: all zeros.

    Args:
        gap: A gap that was measured, for the simulator, the cut-off and speeds.
        experiment: The experiment, taken to be followed perfectly.
    """
    r, robot = experiment.reference, gap.robot
    edge, mask = round(_EDGE * r.rate), np.zeros(len(r.t), dtype=bool)
    mask[edge:-edge] = True
    motion = Motion(experiment.start + r.t, r.q, r.v, r.a, 0 * r.q, mask)
    body = RigidBody(robot.chain, motion)
    tau = simulated_torque(robot, motion, body)
    motion = replace(motion, tau=tau, joints=robot.joints)
    sampler = Sampler.for_rate(motion.rate, gap.cutoff)
    v = motion.v[:: sampler.factor]
    moving = np.abs(v) > _STANDING * np.abs(gap.sampled.v).max(axis=0)
    moving &= sampler.keep(mask)[:, None]
    of = np.zeros(len(v), dtype=np.intp)
    left = np.zeros_like(v)
    return Gap(robot, (motion,), (body,), gap.cutoff, left, moving, of, of)


def joined(references: Sequence[Reference]) -> Reference:
    """References that end where the next one starts, at rest, one after the other."""
    t, parts = np.zeros(1), [[getattr(references[0], x)[:1]] for x in "qva"]
    for r in references:
        t = np.concatenate([t, t[-1] + r.t[1:]])
        for part, x in zip(parts, "qva", strict=True):
            part.append(getattr(r, x)[1:])
    return Reference(t, *(np.concatenate(part) for part in parts))


def _poses(robot: Robot, rng: np.random.Generator) -> Array:
    low, high, _, _ = limits(robot)
    middle, half = (low + high) / 2, 0.7 * (high - low) / 2
    poses = middle + half * rng.uniform(-1, 1, (_POSES, robot.size))
    return np.concatenate([poses, poses[:1]])  # so that it can be run again
