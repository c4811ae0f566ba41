"""Score a delay of the measured torque that all joints share.

Such a delay comes from time stamps of another clock. It is removed from the log before
the search, as it delays the torque of all effects. So the search does not score it.
"""

from __future__ import annotations

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.findings import (
    ExtraFindings,
    finding_of,
    fitted_values,
    torque_shrink,
)
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects.delay import Delay


def delay_finding(
    logged: Gap, scored: Explanation, convention: Convention, rng: np.random.Generator
) -> tuple[ExtraFindings, float]:
    """Make the finding that torque is delayed at every joint.

    Args:
        logged: The gap of the same samples, with the delay.
        scored: The explanation of the gap without the delay.
        convention: The delay.
        rng: Random generator of the bootstrap.

    Returns:
        The finding, and the squares that the terms of the explanation explain on the
        training samples, in units of noise.
    """
    gap = scored.gap
    moving = np.flatnonzero(logged.moving.any(axis=0)).tolist()
    std = float(np.hypot(convention.std, Delay.inexact["time"] * convention.late))
    time = {"time": convention.late}
    effects = tuple(Delay((j,), time, {"time": std}) for j in moving)
    change = logged.left - gap.left

    def with_delay(x: Explanation) -> list[Array]:
        pairs = enumerate(zip(x.evidence.rows, x.after, strict=True))
        return [left + change[rows, i] for i, (rows, left) in pairs]

    train = scored.learnt or scored
    own, others = (
        np.maximum([x @ x - y @ y for x, y in zip(left, train.after, strict=True)], 0)
        / train.evidence.noise
        for left in (with_delay(train), train.before)
    )
    names = [gap.robot.joints[j] for j in moving]
    parameters = [v for e in effects for v in fitted_values(gap, e)]
    shrink = torque_shrink(scored, with_delay(scored), rng)
    finding = finding_of(Delay, names, (), parameters, shrink=shrink)
    return ExtraFindings((finding,), effects, own), float(others.sum())
