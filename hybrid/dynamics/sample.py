"""Regressor of one sample at a time, for work at the rate of a controller."""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.robot import Robot


class SampleRegressor:
    """Torque per unit of every inertial parameter at one instant, in microseconds.

    Equal to :func:`hybrid.dynamics.regressor` of a single sample, which is faster for
    many at once.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: Robot) -> None:
        import pinocchio as pin

        self._model = robot.pinocchio()
        self._data = self._model.createData()
        self._regressor = pin.computeJointTorqueRegressor

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Regressor at one instant.

        Args:
            q: Position, shape (n,), [rad].
            v: Speed, shape (n,), [rad/s].
            a: Acceleration, shape (n,), [rad/s²].

        Returns:
            Y, shape (n, 10n); overwritten by the next call.
        """
        return np.asarray(self._regressor(self._model, self._data, q, v, a))
