"""Positions against joint limits: wrong unit, wrong order, or just outside."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording.recording import Recording

if TYPE_CHECKING:
    from hybrid.robot import Robot

Array = NDArray[np.float64]

SLACK = 0.1  # rad or m: limits in robot files are rounded, encoders overshoot


def check_positions(recording: Recording, robot: Robot) -> None:
    """Hold positions against the limits of their joints.

    Degrees are told from radians by going half a turn beyond a limit, or past two
    turns, while a 57th of the value is plausible; another order by positions that fit
    the limits of other joints but not those of their own.

    Args:
        recording: Joint log, its columns in the order of the robot's joints.
        robot: The arm.

    Raises:
        RecordingError: Positions look like degrees or millimetres, or fit the limits
            in another order of the joints.

    Warns:
        HybridWarning: Positions are outside the limits for no such reason.
    """
    low, high = recording.q.min(axis=0), recording.q.max(axis=0)
    beyond = _beyond(low, high, robot)  # (n, n): column i held against joint j
    own = np.diagonal(beyond)
    _check_unit(recording, robot, own)
    outside = np.flatnonzero(own > SLACK)
    if not outside.size:
        return
    first = outside[0]
    row = int(np.argmax(_outside(recording.q[:, first], robot, first)))
    text = (
        f"{recording.source}: {recording.place('q', first, row)}: "
        f"{recording.q[row, first]:.6g} is outside the limits "
        f"{robot.q_min[first]:.6g} to {robot.q_max[first]:.6g}"
    )
    order = _fitting_order(beyond)
    if order is not None:
        names = [""] * recording.size
        for column, joint in enumerate(order):
            names[column] = robot.joints[joint]
        raise RecordingError(
            f"{text}, but all positions fit if the columns are in the order "
            f"{', '.join(names)}; valid is {', '.join(robot.joints)}"
        )
    others = [recording.place("q", k) for k in outside[1:]]
    also = f"; so are {', '.join(others)}" if others else ""
    warnings.warn(f"{text}{also}", HybridWarning, stacklevel=3)


def _outside(x: Array, robot: Robot, joint: int) -> Array:
    return np.asarray(np.maximum(x - robot.q_max[joint], robot.q_min[joint] - x))


def _beyond(low: Array, high: Array, robot: Robot) -> Array:
    """How far column i goes beyond the limits of joint j, shape (n, n)."""
    over = np.maximum(high[:, None] - robot.q_max, robot.q_min - low[:, None])
    return np.asarray(np.maximum(over, 0.0))


def _check_unit(recording: Recording, robot: Robot, own: Array) -> None:
    peak = np.max(np.abs(recording.q), axis=0)
    turning = robot.chain.revolute
    reach = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    in_degrees = turning & ((own > np.pi) | (peak > 4 * np.pi))
    in_millimetres = ~turning & (own > 10 * reach)
    for suspect, kind, factor, name, unit in (
        (in_degrees, turning, np.pi / 180, "degrees", "rad"),
        (in_millimetres, ~turning, 1e-3, "millimetres", "m"),
    ):
        scaled = recording.q * factor
        beyond = np.diagonal(_beyond(scaled.min(axis=0), scaled.max(axis=0), robot))
        plausible = (beyond <= SLACK) & (peak * factor <= 4 * np.pi)
        if suspect.any() and plausible[kind].all():
            joint = int(np.argmax(np.where(suspect, peak, 0.0)))
            row = int(np.argmax(np.abs(recording.q[:, joint])))
            raise RecordingError(
                f"{recording.source}: {recording.place('q', joint, row)}: "
                f"{recording.q[row, joint]:.6g} looks like {name}; valid are {unit} "
                f"within {robot.q_min[joint]:.6g} to {robot.q_max[joint]:.6g}"
            )


def _fitting_order(beyond: Array) -> NDArray[np.intp] | None:
    """Joint of each column if all positions then fit their limits, else None."""
    from scipy.optimize import linear_sum_assignment

    misfit = beyond > SLACK
    # Of the orders that fit, the one that moves the fewest columns.
    cost = 1000.0 * misfit + 1.0 - np.eye(len(beyond))
    columns, joints = linear_sum_assignment(cost)
    return None if misfit[columns, joints].any() else joints
