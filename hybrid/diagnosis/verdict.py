"""The verdict of a diagnosis."""

from collections.abc import Sequence

from hybrid.diagnosis.answer.diagnosis import EXPLAINED, Finding, Verdict
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.gap.coverage import too_little_motion
from hybrid.diagnosis.gap.gap import Gap

_MISSED = 0.05  # share of a joint's squares, of a gap without a cause


def verdict_of(
    gap: Gap,
    found: Account,
    causes: Sequence[Finding],
    left: float,
    *,
    doubtful: bool,
) -> tuple[Verdict, float]:
    """The verdict, and the unexplained share of the explainable gap.

    Args:
        gap: The gap.
        found: The explained part of it on the training samples.
        causes: The named causes.
        left: Share of it that is left on the test samples.
        doubtful: Whether the file's numbers have larger errors than usual, which no
            cause explains, or are of another arm.
    """
    if too_little_motion(gap):
        return "not_excited", 1.0
    if not causes:
        missed = doubtful or found.missed.any()
        return ("unexplained", 1.0) if missed else ("no_gap", 0.0)
    share = max(found.unknown, left)
    # The causes of other joints do not explain the gap of a joint without a cause.
    alone = (found.missed > found.explained) & (found.missed > _MISSED * found.before)
    if 1.0 - share >= EXPLAINED and not alone.any() and not doubtful:
        return "explained", share
    return "partly_explained", share
