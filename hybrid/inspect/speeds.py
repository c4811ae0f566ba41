"""Compare measured speeds with the derivative of positions.

A sensor may lag, or be wrong by a few percent. A factor, a sign or the speed of another
joint is a fault of the log.
"""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.inspect.doubt import Doubt, error_if
from hybrid.inspect.state import State
from hybrid.recording import Recording
from hybrid.robot import Robot

_WRONG, _ODD = 1.5, 1.1  # factors: an error; worth a warning
_CORRELATED, _UNRELATED = 0.9, 0.5  # correlation of a speed with its derivative
_MOVES = 0.02  # rad or m
_SAME = 1.05  # factor between joints with a common cause
_TOO_FAST = 3.0  # times the limit; an error if times that once more
_FASTEST = 50.0  # rad/s or m/s, of a joint without a known limit
_TINY = 1e-300
_UNITS = {
    180 / np.pi: ("v", "speeds look to be in degrees per second"),
    30 / np.pi: ("v", "speeds look to be in revolutions per minute"),
    np.pi / 180: ("q", "positions look to be in degrees"),
    1e3: ("t", "time looks to be in milliseconds, or speeds"),
    1e6: ("t", "time looks to be in microseconds"),
    1e9: ("t", "time looks to be in nanoseconds"),
}


def doubts_of_speed_limits(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Find joints that move faster than any drive."""
    if robot is None:
        return
    fastest = np.abs(state.v).max(axis=0)
    limit = np.where(robot.v_max > 0, robot.v_max, np.inf)
    highest = np.where(np.isfinite(limit), _TOO_FAST * limit, _FASTEST)
    for j in np.flatnonzero(fastest > highest).tolist():
        unit = robot.chain.unit_at([j], "rad/s")
        text = (
            f"{recording.place('q', j)} moves at {fastest[j]:.4g} {unit}: positions "
            "look to be in degrees, or the clock is too fast"
        )
        valid = limit[j] if np.isfinite(limit[j]) else _FASTEST
        remedy = f"valid are speeds up to {valid:.4g} {unit}"
        severity = error_if(fastest[j] > _TOO_FAST * highest[j])
        yield Doubt("q", (j,), text, remedy, severity, float(fastest[j]))


def doubts_of_speeds(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Doubt]:
    """Find measured speeds that contradict the positions."""
    moving, factor, correlation = _compared(state)
    if not len(moving):
        return
    correlated = np.abs(np.diagonal(correlation)) > _CORRELATED
    wrong = correlated & (np.maximum(np.abs(factor), 1 / np.abs(factor)) > _WRONG)
    logs = np.log(np.abs(factor))
    common = wrong.all() and len(moving) > 1 and np.ptp(logs) < np.log(_SAME)
    if common and (factor > 0).all():
        shared = float(np.exp(logs.mean()))
        near = [x for x in _UNITS if 1 / _SAME < shared / x < _SAME]
        unknown = "t", "the clock or the speeds look scaled by that"
        channel, looks = _UNITS[near[0]] if near else unknown
        text = f"v is {shared:.4g} times dq/dt at every joint: {looks}"
        remedy = "valid are s, rad and rad/s of one clock"
        yield Doubt(channel, (), text, remedy, "error", shared)
        return
    for k in range(len(moving)):
        yield from _of_joint(recording, moving, k, float(factor[k]), correlation[k])


def speeds_confirm_clock(state: State) -> bool:
    """Whether measured speeds agree with positions over the clock."""
    moving, factor, _ = _compared(state)
    return len(moving) > 0 and 1 / _ODD < float(np.median(factor)) < _ODD


def _compared(state: State) -> tuple[Index, Array, Array]:
    """Compare measured speeds with derivatives of positions at k moving joints.

    These, (k,), factors of speeds to their derivatives, (k,), and the correlation of
    each speed with every derivative, (k, k).
    """
    logged = np.zeros_like(state.v) if state.logged is None else state.logged
    moves = (np.ptp(state.q, axis=0) > _MOVES) & (np.ptp(logged, axis=0) > 0)
    derivative, logged = state.v[:, moves], logged[:, moves]
    squares = np.maximum((derivative**2).sum(axis=0), _TINY)
    own = np.maximum((logged**2).sum(axis=0), _TINY)
    correlation = (logged.T @ derivative) / np.sqrt(own[:, None] * squares)
    factor = (logged * derivative).sum(axis=0) / squares
    return np.flatnonzero(moves), factor, correlation


def _of_joint(
    recording: Recording,
    moving: Index,
    k: int,
    factor: float,
    related: Array,
) -> Iterator[Doubt]:
    """Compare the speed of the k-th moving joint with its derivative."""
    joint, own, other = int(moving[k]), related[k], int(np.argmax(np.abs(related)))
    place, derivative = recording.place("v", joint), f"dq{joint + 1}/dt"
    ratio = max(factor, 1 / max(factor, _TINY))
    if abs(own) < _CORRELATED < abs(related[other]):
        text = (
            f"{place} looks like the speed of {recording.joints[moving[other]]}: it "
            f"follows dq{moving[other] + 1}/dt, not {derivative}"
        )
        remedy = "valid are columns of q and v in one order"
        yield Doubt("v", (joint,), text, remedy, "error", float(related[other]))
    elif abs(own) < _UNRELATED:
        text = f"{place} does not follow {derivative} (correlation {own:.2f})"
        yield Doubt("v", (joint,), text, evidence=float(own))
    elif factor < 0 and own < -_CORRELATED:
        text = (
            f"{place} is {factor:.3g} times {derivative}: one counts the other way "
            "round"
        )
        remedy = "valid are q and v of one sign"
        yield Doubt("v", (joint,), text, remedy, "error", factor)
    elif ratio > _ODD and own > _CORRELATED:
        text = f"{place} is {factor:.3g} times {derivative}"
        remedy = "valid are rad/s of the joint"
        yield Doubt("v", (joint,), text, remedy, error_if(ratio > _WRONG), factor)
