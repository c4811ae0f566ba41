"""A motion of an arm that is like any other, where none was recorded."""

from __future__ import annotations

import numpy as np

from hybrid.plant.reference import random_fourier
from hybrid.robot.robot import Robot
from hybrid.signals import Motion

_SECONDS, _RATE = 20.0, 100.0


def typical_motion(robot: Robot) -> Motion:
    """A motion at all speeds within the limits of an arm; torque is not known."""
    rng = np.random.default_rng(0)
    way = random_fourier(robot, duration=_SECONDS, rate=_RATE, seed=rng, fill=0.95)
    unknown = np.full_like(way.q, np.nan)
    every = np.ones(len(way.t), dtype=bool)
    return Motion(way.t, way.q, way.v, way.a, unknown, every, joints=robot.joints)
