"""Pendulums with logs that are worked out: a search takes part of a second."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.dynamics import RigidBody, simulated_torque
from hybrid.effects import Effect
from hybrid.robot import Robot
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

RATE, NOISE = 100.0, 0.02  # Hz, N·m


@cache
def pendulum(size: int = 1) -> Robot:
    """Rods of 2 kg and 0.6 m, one below another, that swing about one axis."""
    rod = [2.0, 0.0, 0.0, -0.6, 0.24, 0.0, 0.24, 0.0, 0.0, 0.01]
    chain = Chain(
        joints=tuple(f"hinge_{k}" for k in range(size)),
        rotation=np.tile(np.eye(3), (size, 1, 1)),
        translation=np.array([[0.0, 0.0, -0.6 * (k > 0)] for k in range(size)]),
        axis=np.tile([0.0, 1.0, 0.0], (size, 1)),
        revolute=np.ones(size, dtype=bool),
        inertial=np.tile(rod, (size, 1)),
        gravity=np.array([0.0, 0.0, -9.81]),
        armature=np.full(size, 0.05),
    )
    one = np.ones(size)
    limits = -2 * one, 2 * one, 10 * one, 60 * one
    return Robot("pendulum", chain, *limits, 0 * one, 0 * one)


def swings(
    size: int = 1,
    *,
    count: int = 4,
    seconds: float = 4.0,
    seed: int = 0,
    widest: float = 0.5,
) -> list[Motion]:
    """Motions of three tones a joint, exact to rounding, with the file's torque."""
    robot, rng = pendulum(size), np.random.default_rng(seed)
    t, found = np.arange(0.0, seconds, 1 / RATE), []
    for k in range(count):
        w = 2 * np.pi * rng.uniform(0.3, 2.0, (3, 1, size))
        angle = w * t[:, None] + rng.uniform(0, 2 * np.pi, w.shape)
        q, v, a = (
            widest * (w**order * np.sin(angle + order * np.pi / 2)).sum(axis=0)
            for order in range(3)
        )
        mask, joints = np.ones(len(t), dtype=bool), robot.joints
        motion = Motion(t, q, v, a, 0 * q, mask, joints=joints, source=f"swing {k}")
        found.append(with_torque(motion, ()))
    return found


def with_torque(
    motion: Motion, effects: Sequence[Effect], noise: float = 0.0, seed: int = 0
) -> Motion:
    """A motion with the torque that the file and some effects say it takes."""
    robot, rng = pendulum(motion.q.shape[1]), np.random.default_rng(seed)
    body = RigidBody(robot.chain, motion)
    tau = simulated_torque(robot, motion, body)
    for effect in effects:
        tau[:, list(effect.joints)] += effect.torque(motion, body)
    return replace(motion, tau=tau + noise * rng.standard_normal(tau.shape))


def gap_of(*effects: Effect, size: int = 1, noise: float = NOISE, **options) -> Gap:
    """The gap of pendulums with effects that their file lacks."""
    logs = [
        with_torque(m, effects, noise, k) for k, m in enumerate(swings(size, **options))
    ]
    return measure_gap(pendulum(size), logs, cutoff=10.0)
