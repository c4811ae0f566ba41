"""Compare positions with joint limits: wrong unit, wrong order, or outside.

A unit is wrong if a position is half a turn beyond its limit, or beyond two turns; a
joint may also count a whole turn off. An order is wrong if positions fit the limits of
other joints but not their own.
"""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.recording import Recording
from hybrid.robot import Robot

SLACK = 0.1  # rad or m: limits in robot files are rounded
_FARTHEST = 4 * np.pi  # rad, of a joint from zero
_ANGLES = ((np.pi / 180, "degrees", "deg"), (1e-3, "milliradians", "mrad"))
_LENGTHS = ((1e-3, "millimetres", "mm"),)


def doubts_of_positions(recording: Recording, robot: Robot | None) -> Iterator[Doubt]:
    """Compare positions with the limits of their joints."""
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
    """Distance of column i beyond the limits of joint j, shape (n, n)."""
    low, high = q.min(axis=0)[:, None], q.max(axis=0)[:, None]
    over = np.maximum(high - robot.q_max, robot.q_min - low)
    return np.asarray(np.maximum(over, 0.0))


def _units(recording: Recording, robot: Robot, own: Array) -> Iterator[Doubt]:
    """Find a wrong unit of revolute, then of prismatic joints."""
    peak = np.max(np.abs(recording.q), axis=0)
    revolute = robot.chain.revolute
    reach = np.maximum(np.abs(robot.q_min), np.abs(robot.q_max))
    for far, kind, unit, smaller in (
        ((own > np.pi) | (peak > _FARTHEST), revolute, "rad", _ANGLES),
        (own > 10 * reach, ~revolute, "m", _LENGTHS),
    ):
        suspect = far & kind
        if not suspect.any():
            continue
        joint = int(np.argmax(np.where(suspect, peak, 0.0)))
        row = int(np.argmax(np.abs(recording.q[:, joint])))
        low, high = robot.q_min[joint], robot.q_max[joint]
        remedy = f"valid are {unit} within {low:.6g} to {high:.6g}"
        fitting = [x for x in smaller if _fits(recording.q * x[0], robot, kind)]
        names = [name for _, name, _ in fitting[:1]]
        remedy += "".join(f", or a label as 'q [{x}]'" for *_, x in fitting[:1])
        turns = suspect * _turns(recording.q, robot)
        if unit == "rad" and _fits(recording.q - 2 * np.pi * turns, robot, kind):
            most = int(np.abs(turns).max())
            off = "a whole turn" if most == 1 else f"{most} whole turns"
            names.append(f"radians {off} off")
        text = f"{recording.place('q', joint, row)}: {recording.q[row, joint]:.6g} "
        looks = f"looks like {', or '.join(names)}"
        text += looks if names else "is far outside the limits"
        # A joint without limits may have made many turns.
        severity = error_if(bool(names) or bool(np.isfinite(reach[joint])))
        joints = tuple(np.flatnonzero(suspect).tolist())
        yield Doubt("q", joints, text, remedy, severity, float(peak[joint]))


def _turns(q: Array, robot: Robot) -> Array:
    """Whole turns from the middle of each joint's limits to its motion, (n,)."""
    limited = np.isfinite(robot.q_min) & np.isfinite(robot.q_max)
    low, high = (np.where(limited, x, 0.0) for x in (robot.q_min, robot.q_max))
    off = (q.min(axis=0) + q.max(axis=0) - low - high) / 2
    return np.asarray(np.where(limited, np.round(off / (2 * np.pi)), np.sign(off)))


def _fits(q: Array, robot: Robot, kind: Mask) -> bool:
    """Whether positions of some joints are within their limits and two turns."""
    within = np.diagonal(_beyond(q, robot)) <= SLACK
    return bool((within & (np.abs(q).max(axis=0) <= _FARTHEST))[kind].all())


def _fitting_order(beyond: Array) -> Index | None:
    """Joint of each column if an order exists in which all positions fit, else None."""
    from scipy.optimize import linear_sum_assignment

    misfit = beyond > SLACK
    # Of the orders that fit, take the one that moves the fewest columns.
    cost = 1000.0 * misfit + 1.0 - np.eye(len(beyond))
    columns, joints = linear_sum_assignment(cost)
    return None if misfit[columns, joints].any() else joints
