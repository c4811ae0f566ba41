"""Merge findings between command and torque with those between torque and motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.answer.command import Link
from hybrid.diagnosis.answer.diagnosis import Diagnosis, Region, Verdict
from hybrid.diagnosis.answer.intervals import interval
from hybrid.diagnosis.explanations.account import Account
from hybrid.diagnosis.gap.gap import Gap

COMMAND_TO_TORQUE = "command to torque"


def merged_links(
    diagnosis: Diagnosis,
    account: Account,
    gap: Gap,
    link: Link,
    rng: np.random.Generator,
) -> Diagnosis:
    """Add findings between command and torque to a diagnosis.

    Shares are of the squares of both links, in units of noise.
    """
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
        replace(
            r,
            share=scale * r.share,
            interval=(scale * r.interval[0], scale * r.interval[1]),
        )
        for r in diagnosis.where
    ]
    for i in np.flatnonzero(excess.sum(axis=0) > 0).tolist():

        def share(k: NDArray[np.intp], i: int = i) -> Array:
            own, every = excess[k, i].sum(axis=1), excess.sum(axis=1)[k].sum(axis=1)
            return np.asarray(own / np.maximum(every + other, 1e-300))

        region = Region(
            diagnosis.joints[i], "link", 0.0, 1.0, COMMAND_TO_TORQUE,
            float(excess[:, i].sum() / (total + other)),
            interval(share, len(excess), rng),
        )  # fmt: skip
        smaller = [k for k, r in enumerate(found) if r.share < region.share]
        found.insert(smaller[0] if smaller else len(found), region)
    return tuple(found)
