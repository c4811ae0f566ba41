"""How well a fleet found planted faults, and what it costs; nothing here prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

import numpy as np
from blind.measures import Ratio
from fleet_plant import FIRST_DAY, SIZES, Arm
from scipy.stats import binom, chi2

from hybrid.fleets.fleet import Fleet
from hybrid.report import Table

_EARLY = 14.0  # d: a date may be off by as much before a fault, to be of it


def _date(week: int) -> float:
    return float((FIRST_DAY + timedelta(7 * week)).toordinal())


def outcomes(
    fleet: Fleet, arms: Sequence[Arm], joints: tuple[str, ...]
) -> list[dict[str, Any]]:
    """What became of every arm: found, named, when, and false alarms."""
    alarms: dict[str, list[tuple[float, float, str, str]]] = {x.name: [] for x in arms}
    for state in fleet.alarms:
        for x in state.changes:
            row = (x.alarm, abs(x.score), state.joint, state.parameter)
            alarms[state.arm].append(row)
    found = []
    for arm in arms:
        start = _date(arm.week) if arm.kind else np.inf
        true = [x for x in alarms[arm.name] if x[0] >= start]
        surest = max(true, key=lambda x: x[1])[2:] if true else ()
        found.append(
            {
                "arm": arm.name, "kind": arm.kind, "size": arm.size,
                "found": bool(true),
                "named": surest in arm.parameters(joints),
                "delay": (min(x[0] for x in true) - start) / 7 if true else None,
                "false": len(alarms[arm.name]) - len(true),
            }
        )  # fmt: skip
    return found


def by_kind(outcomes: Sequence[Mapping[str, Any]], name: str) -> Table:
    """Detections by kind and size of fault, with Wilson intervals."""
    rows = []
    for kind, sizes in SIZES.items():
        for size in sizes:
            own = [x for x in outcomes if (x["kind"], x["size"]) == (kind, size)]
            if own:
                rows.append(_row(kind, f"{size:g}", own))
    faulty = [x for x in outcomes if x["kind"]]
    if faulty:
        rows.append(_row("all", "", faulty))
    header = (
        "fault", "size", "arms", "found", "95 %", "named", "95 %",
        "median delay, weeks", "95 %",
    )  # fmt: skip
    caption = (
        f"{name}: faults found up to the last week, and named by the surest alarm; an "
        "arm that was not found is later than all"
    )
    return Table(header, tuple(rows), caption)


def _row(kind: str, size: str, own: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    hits = [x for x in own if x["found"]]
    named = sum(x["named"] for x in hits)
    delays = [x["delay"] if x["found"] else np.inf for x in own]
    low, high = Ratio(len(hits), len(own)).interval
    below, above = Ratio(named, len(hits)).interval
    return (
        kind, size, str(len(own)), f"{len(hits)}", f"{low:.2f}–{high:.2f}",
        f"{named} of {len(hits)}", f"{below:.2f}–{above:.2f}",
        _weeks(float(np.median(delays))),
        "–".join(map(_weeks, median_interval(delays))),
    )  # fmt: skip


def median_interval(values: Sequence[float]) -> tuple[float, float]:
    """Interval that holds the median with 95 % at least, from order statistics.

    Of five values or fewer it is all there is: from nothing to infinity.
    """
    count = int(binom.ppf(0.025, len(values), 0.5))
    if count == 0:
        return 0.0, np.inf
    ordered = sorted(values)
    return ordered[count - 1], ordered[-count]


def _weeks(delay: float) -> str:
    return f"{delay:.0f}" if np.isfinite(delay) else "∞"


def false_alarms(fleet: Fleet, arms: Sequence[Arm], name: str) -> Table:
    """False alarms of healthy arms per 100 arm-months, and the precision."""
    kinds = {x.name: x for x in arms}
    every = [(kinds[s.arm], x) for s in fleet.alarms for x in s.changes]
    healthy = sum(not arm.kind for arm, _ in every)
    early = sum(x.alarm < _date(arm.week) for arm, x in every if arm.kind)
    periods = {(x["arm"], x["period"]) for x in fleet.rows}
    months = sum(not kinds[arm].kind for arm, _ in periods) * 7 / 30.4375
    rate, high = 100 * healthy / months, 100 * _poisson_upper(healthy) / months
    low = 100 * _poisson_lower(healthy) / months
    alarmed = {arm.name for arm, _ in every}
    right = sum(bool(kinds[x].kind) for x in alarmed)
    below, above = Ratio(right, len(alarmed)).interval
    row = (
        f"{months:.0f}", str(healthy), f"{rate:.2f} ({low:.2f}–{high:.2f})",
        str(early), f"{right} of {len(alarmed)} ({below:.2f}–{above:.2f})",
    )  # fmt: skip
    header = ("healthy arm-months", "false", "per 100 arm-months", "before their fault")
    caption = f"{name}: false alarms, and arms with an alarm that have a fault"
    return Table((*header, "precision by arm"), (row,), caption)


def _poisson_upper(count: int) -> float:
    return float(chi2.ppf(0.975, 2 * count + 2) / 2)


def _poisson_lower(count: int) -> float:
    return float(chi2.ppf(0.025, 2 * count) / 2) if count else 0.0
