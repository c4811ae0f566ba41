"""Positions against joint limits: wrong unit, wrong order, or just outside.

Another unit is told by going half a turn beyond a limit, or past two turns, while the
value in that unit is plausible; another order by positions that fit the limits of other
joints but not those of their own.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.recording import Recording
from hybrid.robot import Robot

SLACK = 0.1  # rad or m: limits in robot files are rounded, encoders overshoot
_TURNS = 4 * np.pi  # rad: an arm's joint does not go farther
_TURNING = ((np.pi / 180, "degrees"), (1e-3, "milliradians"))
_SLIDING = ((1e-3, "millimetres"),)


def doubts_of_positions(recording: Recording, robot: Robot | None) -> Iterator[Doubt]:
    """Hold positions against the limits of their joints."""
    if robot is None:
        return
    beyond = _beyond(recording.q, robot)
    own = np.diagonal(beyond)
    units = list(_units(recording, robot, own))
    yield from units
    outside = np.flatnonzero(own > SLACK).tolist()
    if not outside or units:
        return
    first = outside[0]
    low, high, x = robot.q_min[first], robot.q_max[first], recording.q[:, first]
    row = int(np.argmax(np.maximum(x - high, low - x)))
    place = recording.place("q", first, row)
    text = f"{place}: {x[row]:.6g} is outside the limits {low:.6g} to {high:.6g}"
    order = _fitting_order(beyond)
    if order is not None:
        names = ", ".join(robot.joints[joint] for joint in order)
        text += f", but all positions fit if the columns are in the order {names}"
        also = f"valid is {', '.join(robot.joints)}"
    else:
        others = ", ".join(recording.place("q", k) for k in outside[1:])
        also = f"so are {others}" if others else ""
    severity = error_if(order is not None)
    yield Doubt("q", tuple(outside), text, also, severity, float(own.max()))


def _beyond(q: Array, robot: Robot) -> Array:
    """How far column i goes beyond the limits of joint j, shape (n, n)."""
    low, high = q.min(axis=0)[:, None], q.max(axis=0)[:, None]
    over = np.maximum(high - robot.q_max, robot.q_min - low)
    return np.asarray(np.maximum(over, 0.0))


def _units(recording: Recording, robot: Robot, own: Array) -> Iterator[Doubt]:
    """Positions of turning, then of sliding joints, far outside what these can do."""
    peak = np.max(np.abs(recording.q), axis=0)
    turning = robot.chain.revolute
    reach = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    far = turning & ((own > np.pi) | (peak > _TURNS)), ~turning & (own > 10 * reach)
    for suspect, kind, unit, smaller in (
        (far[0], turning, "rad", _TURNING),
        (far[1], ~turning, "m", _SLIDING),
    ):
        if not suspect.any():
            continue
        joint = int(np.argmax(np.where(suspect, peak, 0.0)))
        row = int(np.argmax(np.abs(recording.q[:, joint])))
        names = [name for x, name in smaller if _fits(recording.q * x, robot, kind)]
        text = f"{recording.place('q', joint, row)}: {recording.q[row, joint]:.6g} "
        text += f"looks like {names[0]}" if names else "is far outside the limits"
        low, high = robot.q_min[joint], robot.q_max[joint]
        remedy = f"valid are {unit} within {low:.6g} to {high:.6g}"
        # What turns without a limit may have turned often.
        severity = error_if(bool(names) or bool(np.isfinite(reach[joint])))
        joints = tuple(np.flatnonzero(suspect).tolist())
        yield Doubt("q", joints, text, remedy, severity, float(peak[joint]))


def _fits(q: Array, robot: Robot, kind: NDArray[np.bool_]) -> bool:
    """Whether positions of some joints are within limits and two turns."""
    within = np.diagonal(_beyond(q, robot)) <= SLACK
    return bool((within & (np.abs(q).max(axis=0) <= _TURNS))[kind].all())


def _fitting_order(beyond: Array) -> NDArray[np.intp] | None:
    """Joint of each column if all positions then fit their limits, else None."""
    from scipy.optimize import linear_sum_assignment

    misfit = beyond > SLACK
    # Of the orders that fit, the one that moves the fewest columns.
    cost = 1000.0 * misfit + 1.0 - np.eye(len(beyond))
    columns, joints = linear_sum_assignment(cost)
    return None if misfit[columns, joints].any() else joints
