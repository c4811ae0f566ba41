"""Measured speed against the slope of positions.

Both are of one joint and one clock. A sensor may lag or be off by a few percent; a
factor, a sign or another joint's speed are of the log.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot

_WRONG, _ODD = 1.5, 1.1  # factors
_FOLLOWS = 0.9  # correlation of a speed with the slope that it is of
_STRANGE = 0.5  # correlation below which it is not
_MOVES = 0.02  # rad or m
_SAME = 1.05  # factor between joints that have one cause in common
_PACE, _TOO_FAST = 3.0, 3.0  # times the limit; times that, and it is an error
_FASTEST = 50.0  # rad/s or m/s, of a joint whose limit is not known
_TINY = 1e-300
_UNITS = {
    180 / np.pi: ("v", "speeds look to be in degrees per second"),
    30 / np.pi: ("v", "speeds look to be in revolutions per minute"),
    np.pi / 180: ("q", "positions look to be in degrees"),
    1e3: ("t", "time looks to be in milliseconds, or speeds"),
    1e6: ("t", "time looks to be in microseconds"),
    1e9: ("t", "time looks to be in nanoseconds"),
}


def doubts_of_pace(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Joints that move faster than any drive does."""
    if robot is None:
        return
    fastest = np.abs(state.v).max(axis=0)
    limit = np.where(robot.v_max > 0, robot.v_max, np.inf)
    usual = np.where(np.isfinite(limit), _PACE * limit, _FASTEST)
    for j in np.flatnonzero(fastest > usual).tolist():
        unit = "rad/s" if robot.chain.revolute[j] else "m/s"
        text = (
            f"{recording.place('q', j)} moves at {fastest[j]:.4g} {unit}: positions "
            "look to be in degrees, or the clock is too fast"
        )
        valid = limit[j] if np.isfinite(limit[j]) else _FASTEST
        remedy = f"valid are speeds up to {valid:.4g} {unit}"
        severity = error_if(fastest[j] > _TOO_FAST * usual[j])
        yield Doubt("q", (j,), text, remedy, severity, float(fastest[j]))


def doubts_of_speeds(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Where measured speeds contradict the positions."""
    moving, factor, alike = _against_slope(state)
    if not len(moving):
        return
    followed = np.abs(np.diagonal(alike)) > _FOLLOWS
    far = followed & (np.maximum(np.abs(factor), 1 / np.abs(factor)) > _WRONG)
    logs = np.log(np.abs(factor))
    common = far.all() and len(moving) > 1 and np.ptp(logs) < np.log(_SAME)
    if common and (factor > 0).all():
        yield _of_all(float(np.exp(logs.mean())))
        return
    for k in range(len(moving)):
        yield from _of_joint(recording, moving, k, float(factor[k]), alike[k])


def bear_out(state: State) -> bool:
    """Whether measured speeds confirm the clock."""
    moving, factor, _ = _against_slope(state)
    return len(moving) > 0 and 1 / _ODD < float(np.median(factor)) < _ODD


def _against_slope(state: State) -> tuple[NDArray[np.intp], Array, Array]:
    """Joints whose position and measured speed both change, k of them.

    And the factor of each one's speed to its slope, (k,), and the correlation of each
    speed with every slope, (k, k).
    """
    logged = np.zeros_like(state.v) if state.logged is None else state.logged
    moves = (np.ptp(state.q, axis=0) > _MOVES) & (np.ptp(logged, axis=0) > 0)
    slope, logged = state.v[:, moves], logged[:, moves]
    squares = np.maximum((slope**2).sum(axis=0), _TINY)
    own = np.maximum((logged**2).sum(axis=0), _TINY)
    alike = (logged.T @ slope) / np.sqrt(own[:, None] * squares)
    factor = (logged * slope).sum(axis=0) / squares
    return np.flatnonzero(moves), factor, alike


def _of_all(factor: float) -> Doubt:
    """A factor that all joints have in common, in words."""
    what = "t", "the clock or the speeds look scaled by that"
    near = [x for x in _UNITS if 1 / _SAME < factor / x < _SAME]
    channel, looks = _UNITS[near[0]] if near else what
    text = f"v is {factor:.4g} times dq/dt at every joint: {looks}"
    remedy = "valid are s, rad and rad/s of one clock"
    return Doubt(channel, (), text, remedy, "error", factor)


def _of_joint(
    recording: Recording, moving: NDArray[np.intp], k: int, factor: float, alike: Array
) -> Iterator[Doubt]:
    """What is wrong with the speed of the k-th joint that moves, if anything."""
    joint, own, other = int(moving[k]), alike[k], int(np.argmax(np.abs(alike)))
    place, slope = recording.place("v", joint), f"dq{joint + 1}/dt"
    off = max(factor, 1 / max(factor, _TINY))
    if abs(own) < _FOLLOWS < abs(alike[other]):
        text = (
            f"{place} looks like the speed of {recording.joints[moving[other]]}: it "
            f"follows dq{moving[other] + 1}/dt, not {slope}"
        )
        remedy = "valid are columns of q and v in one order"
        yield Doubt("v", (joint,), text, remedy, "error", float(alike[other]))
    elif abs(own) < _STRANGE:
        text = f"{place} does not follow {slope} (correlation {own:.2f})"
        yield Doubt("v", (joint,), text, evidence=float(own))
    elif factor < 0 and own < -_FOLLOWS:
        text = f"{place} is {factor:.3g} times {slope}: one counts the other way round"
        remedy = "valid are q and v of one sign"
        yield Doubt("v", (joint,), text, remedy, "error", factor)
    elif off > _ODD and own > _FOLLOWS:
        text = f"{place} is {factor:.3g} times {slope}"
        remedy = "valid are rad/s of the joint"
        yield Doubt("v", (joint,), text, remedy, error_if(off > _WRONG), factor)
