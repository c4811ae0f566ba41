"""Whether recordings suffice to name a cause."""

from __future__ import annotations

import numpy as np

from hybrid.diagnosis.gap.gap import Gap

_SHORTEST = 3.0  # s, of all recordings together
_SHORTEST_MOVING = 1.0  # s, for which a joint moves


def too_little_motion(gap: Gap) -> str | None:
    """Say why recordings do not suffice for a diagnosis; ``None`` if they do."""
    seconds = sum(float(m.t[-1] - m.t[0]) for m in gap.motions)
    if seconds < _SHORTEST * (1 - 1e-3):
        return (
            f"{seconds:.3g} s of recording are too few to name a cause; valid are "
            f"{_SHORTEST:g} s or more"
        )
    if gap.sampled.mask.sum() / gap.rate < _SHORTEST / 2:
        return "less than half of the recordings can be used"
    moving = gap.moving.sum(axis=0) / gap.rate >= _SHORTEST_MOVING
    fewest = min(2, gap.robot.size)
    if moving.sum() < fewest:
        names = ", ".join(np.array(gap.robot.joints)[moving]) or "no joint"
        return (
            f"{names} alone moves: what acts on the others cannot be told from what "
            f"acts on it; valid are motions of {fewest} joints or more"
        )
    return None


def wrong_simulator(gap: Gap) -> str | None:
    """Warn where the gap is larger than the measured torque; ``None`` elsewhere.

    Squares are summed over joints in N²·m², so that the strong joints decide.
    """
    measured = np.where(gap.moving, gap.measured, 0.0)
    left = np.where(gap.moving, gap.left, 0.0)
    if np.sum(left**2) <= np.sum(measured**2):
        return None
    return (
        "the torque that the simulator needs is farther from the measured one than "
        "none at all: is it the file of this robot? is torque in N·m, and position in "
        "radians?"
    )
