"""Findings that the search does not score: a delay of the log, and of the controller.

A delay of torque that all joints share comes from time stamps of another clock. It is
removed from the log before the search, as it delays the torque of all effects.
"""

from dataclasses import replace

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.command import Link
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Region, Verdict
from hybrid.diagnosis.answer.findings import (
    ExtraFindings,
    finding_of,
    fitted_values,
    interval,
    torque_shrink,
)
from hybrid.diagnosis.evidence.convention import Convention
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.explanations.explanation import Explanation
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Port, effect_at

COMMAND_TO_TORQUE = "command to torque"


def delay_finding(
    logged: Gap, scored: Explanation, convention: Convention, rng: np.random.Generator
) -> tuple[ExtraFindings, float]:
    """Find that all torque is late; with the squares that the other terms explain."""
    # ``logged`` is the gap of the same samples with the delay; squares are of the
    # training samples, in units of noise.
    gap = scored.gap
    moving = np.flatnonzero(logged.moving.any(axis=0)).tolist()
    delay, late = effect_at(Port.MEASUREMENT, shifts=True), convention.late
    name = delay.gains[0].name
    std = float(np.hypot(convention.std, delay.inexact.get(name, 0.0) * late))
    effects = tuple(delay((j,), {name: late}, {name: std}) for j in moving)
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
    finding = finding_of(delay, names, (), parameters, shrink=shrink)
    return ExtraFindings((finding,), effects, own), float(others.sum())


def merged_links(
    diagnosis: Diagnosis,
    account: Account,
    gap: Gap,
    link: Link,
    rng: np.random.Generator,
) -> Diagnosis:
    """Add findings between command and torque to a diagnosis."""
    # Shares are of the squares of both links, in units of noise.
    if not link.findings:
        return diagnosis
    noise = np.maximum(diagnosis.noise_floor, 1e-12)
    above = np.where(gap.moving, (gap.left / noise) ** 2 - 1.0, 0.0).sum()
    explained = float(account.explained.sum()) if diagnosis.findings else 0.0
    whole = explained + float(account.missed.sum()) or max(float(above), 0.0)
    verdict: Verdict = {
        "no_gap": "explained", "unexplained": "partly_explained",
    }.get(diagnosis.verdict, diagnosis.verdict)  # type: ignore[assignment]  # fmt: skip
    return replace(
        diagnosis,
        findings=link.merged(diagnosis.findings, explained),
        where=_where(diagnosis, max(float(above), 0.0), link.excess, rng),
        verdict=verdict,
        unexplained=diagnosis.unexplained * whole / (whole + float(link.squares.sum())),
    )


def _where(
    diagnosis: Diagnosis, above: float, excess: Array, rng: np.random.Generator
) -> tuple[Region, ...]:
    """Regions with shares of both links; a new one stands before the first smaller."""
    total = excess.sum()
    other = above if diagnosis.where else 0.0
    scale = other / max(other + total, 1e-300)
    found = [
        replace(r, share=scale * r.share,
                interval=(scale * r.interval[0], scale * r.interval[1]))
        for r in diagnosis.where
    ]  # fmt: skip
    for i in np.flatnonzero(excess.sum(axis=0) > 0).tolist():

        def share(k: Index, i: int = i) -> Array:
            own, every = (x[k].sum(axis=1) for x in (excess[:, i], excess.sum(axis=1)))
            return np.asarray(own / np.maximum(every + other, 1e-300))

        region = Region(
            diagnosis.joints[i], "link", 0.0, 1.0, COMMAND_TO_TORQUE,
            float(excess[:, i].sum() / (total + other)),
            interval(share, len(excess), rng),
        )  # fmt: skip
        smaller = [k for k, r in enumerate(found) if r.share < region.share]
        found.insert(smaller[0] if smaller else len(found), region)
    return tuple(found)
