"""Measured speed against the slope of positions.

Both are of one joint and one clock. A sensor may lag or be off by a few percent; a
factor, a sign or another joint's speed are of the log.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.inspect.doubt import Doubt, Severity
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
_UNITS = {
    180 / np.pi: "speeds look to be in degrees per second",
    30 / np.pi: "speeds look to be in revolutions per minute",
    np.pi / 180: "positions look to be in degrees",
    1e3: "time looks to be in milliseconds, or speeds",
    1e6: "time looks to be in microseconds",
    1e9: "time looks to be in nanoseconds",
}


def doubts_of_pace(recording: Recording, robot: Robot, state: State) -> Iterator[Doubt]:
    """Joints that move faster than any drive does.

    Args:
        recording: The log, for names.
        robot: The arm.
        state: Samples of the log.
    """
    fastest = np.abs(state.v).max(axis=0)
    limit = np.where(robot.v_max > 0, robot.v_max, np.inf)
    usual = np.where(np.isfinite(limit), _PACE * limit, _FASTEST)
    for j in np.flatnonzero(fastest > usual).tolist():
        valid = limit[j] if np.isfinite(limit[j]) else _FASTEST
        unit = "rad/s" if robot.chain.revolute[j] else "m/s"
        text = (
            f"{recording.place('q', j)} moves at {fastest[j]:.4g} {unit}: positions "
            "look to be in degrees, or the clock is too fast"
        )
        remedy = f"valid are speeds up to {valid:.4g} {unit}"
        wrong = fastest[j] > _TOO_FAST * usual[j]
        severity: Severity = "error" if wrong else "warning"
        yield Doubt("q", (j,), text, remedy, severity, float(fastest[j]))


def doubts_of_speeds(recording: Recording, state: State) -> Iterator[Doubt]:
    """Where measured speeds contradict the positions.

    Args:
        recording: The log, for names.
        state: Samples of the log.
    """
    if state.logged is None:
        return
    moving = _moving(state, state.logged)
    slope, logged = state.v[:, moving], state.logged[:, moving]
    squares = np.maximum((slope**2).sum(axis=0), 1e-300)
    alike = (logged.T @ slope) / np.sqrt(
        np.maximum((logged**2).sum(axis=0), 1e-300)[:, None] * squares
    )  # (speed, slope)
    factor = (logged * slope).sum(axis=0) / squares
    followed = np.abs(np.diagonal(alike)) > _FOLLOWS
    far = followed & (np.maximum(np.abs(factor), 1 / np.abs(factor)) > _WRONG)
    common = (
        far.all() and len(moving) > 1 and np.ptp(np.log(np.abs(factor))) < np.log(_SAME)
    )
    if common and (factor > 0).all():
        yield _of_all(float(np.exp(np.log(factor).mean())))
        return
    for k, j in enumerate(moving):
        yield from _of_joint(recording, j, float(factor[k]), alike[k], k, moving)


def bear_out(state: State) -> bool:
    """Whether measured speeds confirm the clock."""
    if state.logged is None:
        return False
    moving = _moving(state, state.logged)
    slope, logged = state.v[:, moving], state.logged[:, moving]
    factor = (logged * slope).sum(axis=0) / np.maximum((slope**2).sum(axis=0), 1e-300)
    return len(moving) > 0 and 1 / _ODD < float(np.median(factor)) < _ODD


def _moving(state: State, logged: Array) -> list[int]:
    """Joints whose position and measured speed both change."""
    moves = (np.ptp(state.q, axis=0) > _MOVES) & (np.ptp(logged, axis=0) > 0)
    return [int(j) for j in np.flatnonzero(moves)]


def _of_all(factor: float) -> Doubt:
    """A factor that all joints have in common, in words."""
    near = [x for x in _UNITS if 1 / _SAME < factor / x < _SAME]
    what = _UNITS[near[0]] if near else "the clock or the speeds look scaled by that"
    text = f"v is {factor:.4g} times dq/dt at every joint: {what}"
    channel = "v" if near and "speeds" in what and "time" not in what else "t"
    if near and what.startswith("positions"):
        channel = "q"
    remedy = "valid are s, rad and rad/s of one clock"
    return Doubt(channel, (), text, remedy, "error", factor)


def _of_joint(
    recording: Recording,
    joint: int,
    factor: float,
    alike: Array,
    own: int,
    moving: list[int],
) -> Iterator[Doubt]:
    """What is wrong with the speed of one joint, if anything."""
    place, slope = recording.place("v", joint), f"dq{joint + 1}/dt"
    other = int(np.argmax(np.abs(alike)))
    if abs(alike[own]) < _FOLLOWS < abs(alike[other]):
        text = (
            f"{place} looks like the speed of {recording.joints[moving[other]]}: it "
            f"follows dq{moving[other] + 1}/dt, not {slope}"
        )
        remedy = "valid are columns of q and v in one order"
        yield Doubt("v", (joint,), text, remedy, "error", float(alike[other]))
    elif abs(alike[own]) < _STRANGE:
        text = f"{place} does not follow {slope} (correlation {alike[own]:.2f})"
        yield Doubt("v", (joint,), text, "", "warning", float(alike[own]))
    elif factor < 0 and alike[own] < -_FOLLOWS:
        text = f"{place} is {factor:.3g} times {slope}: one counts the other way round"
        remedy = "valid are q and v of one sign"
        yield Doubt("v", (joint,), text, remedy, "error", factor)
    elif max(factor, 1 / max(factor, 1e-300)) > _ODD and alike[own] > _FOLLOWS:
        wrong = max(factor, 1 / factor) > _WRONG
        text = f"{place} is {factor:.3g} times {slope}"
        remedy = "valid are rad/s of the joint"
        severity: Severity = "error" if wrong else "warning"
        yield Doubt("v", (joint,), text, remedy, severity, factor)
