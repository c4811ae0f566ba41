"""An arm in some postures: its joints, and the capsules that cover its links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.excitation.clearance import ends_in_world, frames
from hybrid.robot.geometry import capsules_from_robot
from hybrid.robot.robot import Robot


@dataclass(frozen=True, eq=False)
class Postures:
    """K postures of an arm of n joints in the base frame.

    Attributes:
        joints: Base and joint origins, shape (K, n + 1, 3), [m].
        ends: End points of C capsules, shape (K, C, 2, 3), [m]; none of an arm whose
            file holds no geometry.
        radius: Their radii, shape (C,), [m].
    """

    joints: Array
    ends: Array
    radius: Array

    @classmethod
    def of(cls, robot: Robot, q: Array) -> Postures:
        """Place an arm.

        Args:
            robot: The arm.
            q: Positions, shape (K, n), [rad or m].
        """
        origins = frames(robot.chain, q)[1].transpose(1, 0, 2)
        joints = np.concatenate([np.zeros((len(q), 1, 3)), origins], axis=1)
        try:
            capsules = capsules_from_robot(robot)
        except RobotError:
            return cls(joints, np.zeros((len(q), 0, 2, 3)), np.zeros(0))
        return cls(joints, ends_in_world(robot.chain, capsules, q), capsules.radius)

    @property
    def box(self) -> tuple[Array, float]:
        """Middle and half width of a cube that holds all postures, [m]."""
        parts = self.joints.reshape(-1, 3), self.ends.reshape(-1, 3)
        points = np.concatenate(parts)
        low, high = points.min(axis=0), points.max(axis=0)
        return (low + high) / 2, max(0.55 * float((high - low).max()), 1e-3)
