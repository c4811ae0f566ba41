"""Whether a log's columns are in another order than the joints, or count the other way.

Joint states are often logged sorted by name, and a drive counts as it was mounted. What
would explain such a log is no cause.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hybrid.diagnose.gap import Gap, simulated_torque
from hybrid.dynamics import RigidBody
from hybrid.robot.chain import Array
from hybrid.signals import Motion

_FAR = 0.5  # of squares of measured torque: nearer, nothing is mixed up
_NEARER = 0.25  # of the same squares, if read otherwise
_ENOUGH = 1000  # samples
_WHAT = {
    (True, True): "the columns",
    (True, False): "the positions",
    (False, True): "the torques",
}


@dataclass(frozen=True, eq=False)
class _Reading:
    """Another way to read a log.

    Attributes:
        words: What is the matter with the log, if this is the right one.
        order: Which column is each joint's, shape (n,).
        sign: Which way each joint counts, shape (n,).
        position: Whether positions are to be read so.
        torque: Whether torque is.
    """

    words: str
    order: NDArray[np.intp]
    sign: Array
    position: bool
    torque: bool

    def of(self, motion: Motion) -> Motion:
        """A motion as it is by this reading."""
        if self.position:
            q, v, a = (
                self.sign * x[:, self.order] for x in (motion.q, motion.v, motion.a)
            )
            motion = replace(motion, q=q, v=v, a=a)
        if self.torque:
            motion = replace(motion, tau=self.sign * motion.tau[:, self.order])
        return motion


def mixed_up(gap: Gap) -> str | None:
    """A warning where columns in another order, or of another sign, fit far better.

    Args:
        gap: The gap with the log taken at its word.
    """
    usable = np.flatnonzero(gap.moving.any(axis=1))
    some = usable[:: max(len(usable) // _ENOUGH, 1)]
    seen = gap.sampled
    t, q, v, a = (x[some] for x in (seen.t, seen.q, seen.v, seen.a))
    motion = Motion(t, q, v, a, gap.measured[some], np.ones(len(some), dtype=bool))
    plain = _left(gap, motion)
    if plain < _FAR:
        return None
    left, words = min((_left(gap, x.of(motion)), x.words) for x in _readings(gap))
    if left > _NEARER * plain:
        return None
    return f"{words}: the log is much nearer to the simulator if read that way"


def _left(gap: Gap, motion: Motion) -> float:
    """Squares of the gap, of those of each joint's torque, added up."""
    body = RigidBody(gap.robot.chain, motion)
    left = motion.tau - simulated_torque(gap.robot, motion, body)
    size = (motion.tau**2).sum(axis=0)
    return float(((left**2).sum(axis=0) / np.where(size > 0, size, np.inf)).sum())


def _readings(gap: Gap) -> Iterator[_Reading]:
    """All ways in which two columns, or the sign of one, may be mixed up."""
    n, names = gap.robot.size, gap.robot.joints
    moving = np.flatnonzero(gap.moving.any(axis=0)).tolist()
    for which, what in _WHAT.items():
        for a, b in combinations(moving, 2):
            order = np.arange(n)
            order[[a, b]] = b, a
            words = f"{what} of {names[a]} and {names[b]} seem to be swapped"
            yield _Reading(words, order, np.ones(n), *which)
        for a in moving:
            sign = np.where(np.arange(n) == a, -1.0, 1.0)
            words = f"{what} of {names[a]} seem to count the other way round"
            yield _Reading(words, np.arange(n), sign, *which)
