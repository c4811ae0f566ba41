"""Logs of ``calibration_intervals.py``: what an instrument sees of a disturbed arm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.calibration import Measurements, random_poses
from hybrid.calibration.geometry import geometry_from_chain
from hybrid.calibration.steps import follow, start
from hybrid.robot import Robot

KINDS = ("three reflectors", "position", "pose", "distances")
ERRORS = ("independent", "joints", "instrument", "eccentric encoders")
NOISE, JOINT, POINT, ECCENTRIC = 5e-5, 1e-4, 1e-4, 2e-4  # m and rad


@dataclass(frozen=True)
class Log:
    """Poses of an arm whose joint frames are off by 1 mm and 2 mrad a direction.

    Attributes:
        robot: Nominal arm.
        kind: What is measured, of ``KINDS``.
        error: What is wrong with it, of ``ERRORS``, or none.
        poses: How many.
        seed: Of poses and errors; the arm is the same for all.
    """

    robot: Robot
    kind: str
    error: str
    poses: int
    seed: int

    def measured(self) -> Measurements:
        """What was measured, with the joint positions that were commanded."""
        rng, n = np.random.default_rng(self.seed), self.robot.size
        q = random_poses(self.robot, self.poses, rng)
        turned = q + JOINT * (self.error == "joints") * rng.normal(size=q.shape)
        if self.error == "eccentric encoders":
            turned = q + ECCENTRIC * np.sin(q + np.arange(n))
        return replace(self._seen(turned, rng), q=q)

    def _seen(self, q: np.ndarray, rng: np.random.Generator) -> Measurements:
        place = np.random.default_rng(99)
        chain = self.robot.chain
        turn = Rotation.from_rotvec(2e-3 * place.normal(size=(chain.size, 3)))
        shift = 1e-3 * place.normal(size=(chain.size, 3))
        chain = replace(
            chain,
            rotation=chain.rotation @ turn.as_matrix(),
            translation=chain.translation + shift,
        )
        end = follow(start(q), geometry_from_chain(chain).steps, q, {})
        B, X = (Rotation.random(rng=place).as_matrix() for _ in range(2))
        b, x = 2 * place.normal(size=3), 0.15 * place.normal(size=(3, 3))
        stations = 2 * place.normal(size=(3, 3))
        own = NOISE * (self.error != "none")
        common = POINT * (self.error == "instrument")
        points = end.origin[:, None] + (end.rotation[:, None] @ x[:, :, None])[..., 0]
        if self.kind == "distances":
            d = np.linalg.norm(points[:, :1] - stations, axis=-1)
            d = (
                d
                + own * rng.normal(size=d.shape)
                + common * rng.normal(size=(len(q), 1))
            )
            return Measurements(q, np.zeros((len(q), 0, 3)), None, d)
        seen = points @ B.T + b + own * rng.normal(size=points.shape)
        seen += common * rng.normal(size=(len(q), 1, 3))
        if self.kind == "three reflectors":
            return Measurements(q, seen)
        if self.kind == "position":
            return Measurements(q, seen[:, :1])
        turn = Rotation.from_rotvec(own * rng.normal(size=(len(q), 3)))
        rotation = turn.as_matrix() @ B @ end.rotation @ X
        return Measurements(q, seen[:, :1], rotation)
