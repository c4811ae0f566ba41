"""Regressor of one sample at a time, at the rate of a controller."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.law import Law
from hybrid.dynamics.newton_euler import newton_euler
from hybrid.dynamics.tape import Tape
from hybrid.robot import Robot


class SampleRegressor:
    """Torque per unit of inertial parameters at one instant, in microseconds.

    It equals :func:`hybrid.dynamics.regressor`, which is faster for many samples. The
    inverse dynamics of all unit parameters are on one tape, which computes common terms
    once.

    Args:
        robot: The arm.
        entries: Indices of the wanted entries of the flattened regressor, length c; all
            10n² by default.
    """

    def __init__(self, robot: Robot, entries: Sequence[int] | None = None) -> None:
        chain, n, tape = robot.chain, robot.size, Tape()
        names = tuple(f"{x}_{k}" for x in "qva" for k in range(n))
        given = [tape.input(name) for name in names]
        q, v, a = given[:n], given[n : 2 * n], given[2 * n :]
        gravity = chain.gravity.tolist()
        columns = [
            newton_euler(chain, unit.reshape(n, 10).tolist(), gravity, q=q, v=v, a=a)
            for unit in np.eye(10 * n)
        ]
        rows = [torque for joint in zip(*columns, strict=True) for torque in joint]
        wanted = rows if entries is None else [rows[k] for k in entries]
        self._law = Law(tape, tuple(wanted), names)

    def __call__(self, q: Array, v: Array, a: Array) -> Array:
        """Entries at one instant, shape (c,).

        Args:
            q: Position, shape (n,), [rad].
            v: Speed, shape (n,), [rad/s].
            a: Acceleration, shape (n,), [rad/s²].
        """
        return np.array(self._law.at([*q.tolist(), *v.tolist(), *a.tolist()]))
