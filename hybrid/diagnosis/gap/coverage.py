"""What recordings do not cover, and whether they suffice to name a cause."""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.identification.preparation import STANDING

_STILL = 0.005  # rad; range of a joint at rest, by noise and servo
_SHORTEST = 0.2  # s, in a condition
_FEWEST_REVERSALS = 3
_SPEEDS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)  # rad/s
_SLOW = 0.2  # of the highest speed visited
_ENOUGH = 0.5  # of a limit of speed or position
_LEAST_SECONDS = 3.0  # s, of all recordings together
_LEAST_MOVING = 1.0  # s, for which a joint moves


def not_excited(gap: Gap) -> tuple[str, ...]:
    """Conditions that the recordings do not cover, the most important ones first."""
    found = [entry for i in range(gap.robot.size) for entry in _missing(gap, i)]
    return tuple(text for _, text in sorted(found, key=lambda entry: entry[0]))


def _missing(gap: Gap, i: int) -> Iterator[tuple[int, str]]:
    """Yield what joint i does not cover, with its rank."""
    name, unit = gap.robot.joints[i], gap.robot.chain.unit_at([i], "rad")
    usable = gap.sampled.mask
    q, v = gap.sampled.q[usable, i], gap.sampled.v[usable, i]
    if q.size == 0 or np.ptp(q) < _STILL:
        yield 0, f"{name} does not move"
        return
    fewest, speed = _SHORTEST * gap.rate, np.abs(v)
    still = STANDING * speed.max()
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
    """Count the changes of sign of a speed, (N,), [rad/s], that is above ``still``."""
    sign = np.sign(v[np.abs(v) > still])
    return int(np.count_nonzero(sign[1:] != sign[:-1]))


def too_little_motion(gap: Gap) -> str | None:
    """Say why recordings do not suffice for a diagnosis; ``None`` if they do."""
    seconds = sum(float(m.t[-1] - m.t[0]) for m in gap.motions)
    if seconds < _LEAST_SECONDS * (1 - 1e-3):
        return (
            f"{seconds:.3g} s of recording are too few to name a cause; valid are "
            f"{_LEAST_SECONDS:g} s or more"
        )
    if gap.sampled.mask.sum() / gap.rate < _LEAST_SECONDS / 2:
        return "less than half of the recordings can be used"
    moving = gap.moving.sum(axis=0) / gap.rate >= _LEAST_MOVING
    fewest = min(2, gap.robot.size)
    if moving.sum() < fewest:
        names = ", ".join(np.array(gap.robot.joints)[moving]) or "no joint"
        return (
            f"{names} alone moves: what acts on the others cannot be told from what "
            f"acts on it; valid are motions of {fewest} joints or more"
        )
    return None
