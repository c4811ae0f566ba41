"""Whether recordings give grounds for naming any cause."""

from __future__ import annotations

import numpy as np

from hybrid.diagnose.gap import Gap
from hybrid.diagnose.model import WIDEST, Model
from hybrid.diagnose.products import Index
from hybrid.diagnose.term import Term
from hybrid.robot.chain import Array

_FEWEST_SECONDS = 3.0
_FEWEST_MOVING = 1.0  # s
_FAR = 5.0  # deviations of the widest background
_ABSURD = 0.5  # of a number: no file is off by that much
_MAIN = 0.2  # of what is made at the joint where most is


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


def another_arm(gap: Gap, terms: list[Term]) -> str | None:
    """A warning where most links would have to be others than the simulator's."""
    wrong = {t.place[1][-1] for t in terms if t.place[0] == "link_inertia"}
    if len(wrong) < max(3, gap.robot.size / 2):
        return None
    return (
        f"the inertia of {len(wrong)} links is not the simulator's: is it the file of "
        "this robot?"
    )


def far_off(model: Model) -> str | None:
    """A warning where numbers of the file explain the gap only if they are far off.

    No more of a gap may be left then, but the file is not right.
    """
    _, gains, off = _strained(model, _FAR * WIDEST)
    if not len(gains):
        return None
    return (
        f"what no effect explains would need numbers of the file to be off by "
        f"{off.max():.0%}"
    )


def overshadowed(model: Model) -> list[Term]:
    """Terms that explain less at their joints than numbers do that cannot be so.

    What is wrong there is not the file, nor what a term explains beside that.
    """
    numbers, gains, _ = _strained(model, _ABSURD)
    if not len(numbers):
        return []
    made = model.evidence.made(numbers, gains)
    there = set(np.flatnonzero(made >= _MAIN * made.max()))
    rest = np.setdiff1d(model.base(), numbers)
    with model.assuming(WIDEST):
        much = model.worth() - model.evidence.solve(rest).evidence
        own = model.losses()
    return [
        t
        for t, loss in zip(model.terms, own, strict=True)
        if loss < much and there & {*t.candidate.effect.reaches(model.gap.robot.size)}
    ]


def _strained(model: Model, least: float) -> tuple[Index, Array, Array]:
    """Numbers of the file that are off by at least this much.

    Args:
        model: The model.
        least: How much, of the number.

    Returns:
        Which numbers, by how much, and the same relative, shape (k,).
    """
    evidence, rigid = model.evidence, model.background
    with model.assuming(WIDEST):
        gains = evidence.solve(model.base()).of(rigid)
        off = np.abs(gains) * np.sqrt(evidence.precision[rigid]) * WIDEST
    far = off >= least
    return rigid[far], gains[far], off[far]
