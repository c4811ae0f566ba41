"""The verdict of a diagnosis."""

from collections.abc import Sequence

import numpy as np

from hybrid.diagnosis.answer.diagnosis import EXPLAINED, Finding, Unseen, Verdict
from hybrid.diagnosis.explanations.account import Account

_MISSED = 0.05  # share of a joint's squares, of a gap without a cause
_CLEAR = 1.5  # times the noise on held-out motion, of the same


def verdict_of(
    found: Account,
    causes: Sequence[Finding],
    unseen: Unseen,
    left: float,
    *,
    doubtful: bool,
) -> tuple[Verdict, float]:
    """The verdict, and the unexplained share of the explainable gap."""
    # ``left`` is the share on the test samples. It is doubtful if numbers of the file
    # have larger errors than usual, which no cause explains, or are of another arm.
    if not causes:
        missed = doubtful or found.missed.any()
        return ("unexplained", 1.0) if missed else ("no_gap", 0.0)
    share = max(found.unknown, left)
    # The causes of other joints do not explain the gap of a joint without a cause.
    alone = (found.missed > found.explained) & (found.missed > _MISSED * found.before)
    before, named, noise = map(np.array, (unseen.before, unseen.named, unseen.noise))
    alone |= (named > _CLEAR * noise) & (2 * named**2 > before**2 + noise**2)
    if 1.0 - share >= EXPLAINED and not alone.any() and not doubtful:
        return "explained", share
    return "partly_explained", share
