"""A fit of fixed structure by ``mujoco.sysid``, to stand beside a diagnosis.

Free are armature, damping and friction loss of six joints and the mass of the last
link; the start is what the file says, which is the truth. It needs ``mujoco[sysid]``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np
from blind.sysid import SysidFit, fit_sysid

from hybrid import Robot
from hybrid.plant import Plant
from hybrid.recording import Recording


@dataclass(frozen=True)
class Fitted:
    """Parameters that came out.

    Attributes:
        robot: The arm with them.
        fit: What was found; what the file says is the truth.
        seconds: Processor time.
    """

    robot: Robot
    fit: SysidFit
    seconds: float

    @property
    def wrong(self) -> np.ndarray:
        """Relative errors, shape (p,)."""
        return np.asarray(np.abs(self.fit.values / self.fit.declared - 1))

    @property
    def inside(self) -> np.ndarray:
        """Which true values lie in their intervals, shape (p,)."""
        return np.asarray(np.abs(self.fit.values - self.fit.declared) <= self.fit.half)

    def as_dict(self) -> dict[str, Any]:
        """JSON-ready content."""
        fit = self.fit
        return {
            "names": fit.names, "values": fit.values, "true": fit.declared,
            "half": fit.half, "cpu_seconds": self.seconds,
        }  # fmt: skip


def fit_by_sysid(robot: Robot, plant: Plant, log: Recording) -> Fitted:
    """Fit 19 parameters to one log, in closed loop with the servos' own gains."""
    assert plant.servo is not None
    begin = process_time()
    fit = fit_sysid(replace(robot, kp=plant.servo.kp, kd=plant.servo.kd), log)
    return Fitted(_with_values(robot, fit.values), fit, process_time() - begin)


def _with_values(robot: Robot, values: np.ndarray) -> Robot:
    armature, damping, friction = values[:-1].reshape(3, -1)
    inertial = robot.chain.inertial.copy()
    # The mass alone changes: its centre stays, and so does its inertia about it.
    mass, moment = inertial[-1, 0], inertial[-1, 1:4]
    centre, added = moment / mass, values[-1] - mass
    xx, xy, yy, xz, yz, zz = ((centre @ centre) * np.eye(3) - np.outer(centre, centre))[
        [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    ]
    inertial[-1] += added * np.array([1, *centre, xx, xy, yy, xz, yz, zz])
    chain = replace(robot.chain, inertial=inertial, armature=armature)
    return replace(robot, chain=chain, damping=damping, frictionloss=friction)
