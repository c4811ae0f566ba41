"""What the recordings do not show: joints, speeds, directions, positions."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.units import units

_STILL = 0.005  # rad; what a joint at rest seems to move, by noise and servo
_FEWEST_SECONDS = 0.2
_FEWEST_REVERSALS = 3
_SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)  # rad/s
_SLOW = 0.2  # of the highest speed visited
_ENOUGH = 0.5  # of a limit


def not_excited(gap: Gap) -> tuple[str, ...]:
    """Conditions that the recordings do not visit, in words.

    Nothing can be said of an effect there. What an arm needs to show most comes first:
    joints that move, in both directions, slowly, with reversals, fast, and far.

    Args:
        gap: The gap.

    Returns:
        For example ``wrist does not move`` or ``elbow moving down``.
    """
    lists = [list(_missing(gap, i)) for i in range(gap.robot.size)]
    found = [entry for entries in lists for entry in entries]
    return tuple(text for _, text in sorted(found, key=lambda entry: entry[0]))


def _missing(gap: Gap, i: int) -> Iterator[tuple[int, str]]:
    """What joint i does not visit, with a rank."""
    name, (unit, _) = gap.robot.joints[i], units(gap.robot, [i])
    usable = gap.sampled.mask
    q, v = gap.sampled.q[usable, i], gap.sampled.v[usable, i]
    if q.size == 0 or np.ptp(q) < _STILL:
        yield 0, f"{name} does not move"
        return
    fewest, speed = _FEWEST_SECONDS * gap.rate, np.abs(v)
    still = 0.01 * speed.max()
    for word, moving in (("up", v > still), ("down", v < -still)):
        if moving.sum() < fewest:
            yield 1, f"{name} moving {word}"
    slow = [x for x in _SPEEDS if (speed < x).sum() < fewest]
    if slow and slow[-1] > _SLOW * speed.max():
        yield 2, f"{name} below {slow[-1]:g} {unit}/s"
    if reversals(v, still) < _FEWEST_REVERSALS:
        yield 3, f"reversals of {name}"
    fastest = float(np.quantile(speed, 0.99))
    if fastest < _ENOUGH * gap.robot.v_max[i] < np.inf:
        yield 4, f"{name} above {fastest:.2g} {unit}/s"
    room = gap.robot.q_max[i] - gap.robot.q_min[i]
    if np.ptp(q) < _ENOUGH * room < np.inf:
        yield 5, f"{name} beyond {q.min():.2g} to {q.max():.2g} {unit}"


def reversals(v: Array, still: float) -> int:
    """How often a speed changes its sign, from beyond a threshold to beyond it.

    Args:
        v: Speed, shape (N,), [rad/s].
        still: Speed up to which a joint counts as standing, [rad/s].
    """
    sign = np.sign(v[np.abs(v) > still])
    return int(np.count_nonzero(sign[1:] != sign[:-1]))
