"""Motions of an arm at work, for a loop that otherwise follows random ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hybrid.plant import Reference, random_fourier
from hybrid.robot import Robot

RAMP = 0.3  # s, to full speed
RESTS = 0.2, 0.5  # s, between two moves
PART = 0.8  # of the speed of the random motion

Make = Callable[..., Reference]


def visits(
    robot: Robot,
    *,
    duration: float,
    rate: float,
    seed: int | np.random.Generator,
    one: bool = False,
) -> Reference:
    """Move from pose to pose at trapezoidal speed, with rounded ramps, and rest there.

    Args:
        robot: The arm.
        duration: Of the motion, [s].
        rate: Samples per second, [Hz].
        seed: Seed or generator of poses and rests.
        one: Whether one joint moves at a time, the first one first.
    """
    rng = np.random.default_rng(seed)
    free = random_fourier(robot, duration=duration, rate=rate, seed=rng)
    low, high = free.q.min(axis=0), free.q.max(axis=0)
    top, pose, n = PART * np.abs(free.v).max(axis=0), free.q[0], robot.size
    parts: list[np.ndarray] = []
    while sum(map(len, parts)) < len(free.t):
        goal = rng.uniform(low, high)
        if one:
            goal = np.where(np.arange(n) == len(parts) % n, goal, pose)
        needed = float((np.abs(goal - pose) / top).max()) + RAMP
        t = np.arange(round(max(needed, 2 * RAMP) * rate)) / rate
        ramp = np.clip(np.minimum(t, t[-1] - t) / RAMP, 0.0, 1.0)
        way = np.cumsum(0.5 - 0.5 * np.cos(np.pi * ramp))
        rest = np.ones(round(rng.uniform(*RESTS) * rate))
        way = np.concatenate([way / way[-1], rest])
        parts.append(pose + way[:, None] * (goal - pose))
        pose = goal
    q = np.concatenate(parts)[: len(free.t)]
    v = np.gradient(q, 1 / rate, axis=0)
    return Reference(free.t, q, v, np.gradient(v, 1 / rate, axis=0))


def again(make: Make) -> Make:
    """The first motion that something makes, every time."""
    made: list[Reference] = []

    def first(robot: Robot, **settings: object) -> Reference:
        if not made:
            made.append(make(robot, **settings))
        return made[0]

    return first
