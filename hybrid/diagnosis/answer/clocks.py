"""Torque that is late at every joint: what stamping it by another clock accounts for.

It is taken back before anything else is looked for, since all torque is late, that of
effects included. So it is no term of a search, and is scored here.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.diagnosis.answer.findings import Beside, fall, found_at, values
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects.delay import Delay


def clocks_apart(
    logged: Gap, scored: Explanation, convention: Convention, rng: np.random.Generator
) -> tuple[Beside, float]:
    """The finding that torque is late at every joint.

    Args:
        logged: The gap with the log taken at its word, of the same samples.
        scored: What was found in the log without the delay.
        convention: By how much torque is late.
        rng: Draws of the bootstrap.

    Returns:
        It, and what the terms explain on the samples learnt from, in units of noise.
    """
    gap = scored.gap
    moving = np.flatnonzero(logged.moving.any(axis=0)).tolist()
    std = float(np.hypot(convention.std, Delay.inexact["time"] * convention.late))
    time = {"time": convention.late}
    effects = tuple(Delay((j,), time, {"time": std}) for j in moving)
    change = logged.left - gap.left

    def late(x: Explanation) -> list[Array]:
        pairs = enumerate(zip(x.evidence.rows, x.after, strict=True))
        return [left + change[rows, i] for i, (rows, left) in pairs]

    learnt = scored.learnt or scored
    own, others = (
        np.maximum([x @ x - y @ y for x, y in zip(left, learnt.after, strict=True)], 0)
        / learnt.evidence.noise
        for left in (late(learnt), learnt.before)
    )
    names = [gap.robot.joints[j] for j in moving]
    parameters = [v for e in effects for v in values(gap, e)]
    finding = replace(
        found_at(Delay, names, (), parameters),
        shrink={"torque": fall(scored, late(scored), rng)},
    )
    return Beside((finding,), effects, own), float(others.sum())
