"""Whether recordings give grounds for naming any cause."""

from __future__ import annotations

import numpy as np

from hybrid.diagnosis.gap.gap import Gap

_FEWEST_SECONDS = 3.0
_FEWEST_MOVING = 1.0  # s


def too_little(gap: Gap) -> str | None:
    """Why recordings say nothing at all; nothing if they say something."""
    seconds = sum(float(m.t[-1] - m.t[0]) for m in gap.motions)
    if seconds < _FEWEST_SECONDS * (1 - 1e-3):
        return (
            f"{seconds:.3g} s of recording are too few to name a cause; valid are "
            f"{_FEWEST_SECONDS:g} s or more"
        )
    if gap.sampled.mask.sum() / gap.rate < _FEWEST_SECONDS / 2:
        return "less than half of the recordings can be used"
    moving = gap.moving.sum(axis=0) / gap.rate >= _FEWEST_MOVING
    fewest = min(2, gap.robot.size)
    if moving.sum() < fewest:
        names = ", ".join(np.array(gap.robot.joints)[moving]) or "no joint"
        return (
            f"{names} alone moves: what acts on the others cannot be told from what "
            f"acts on it; valid are motions of {fewest} joints or more"
        )
    return None


def unlike(gap: Gap) -> str | None:
    """A warning where the simulator is no nearer to the arm than no simulator at all.

    Squares add up over joints in N²·m², in which the joints that carry the arm count.
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
