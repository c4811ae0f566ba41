"""The verb: which arms of a fleet change, when, in what, and which are unlike others.

``value = level of the arm + slope · (temperature, load) + what all arms share in a
period + change + noise``: the slopes and what is shared come from all arms together,
by medians, so that arms with a fault do not count; the noise from differences between
successive periods. What is left of an arm is its own, see
:mod:`hybrid.fleets.changes`.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import median_abs_deviation

from hybrid.arrays import Array
from hybrid.fleets.changes import (
    MONTH,
    Change,
    Level,
    changes,
    crossing,
    level,
    threshold,
)
from hybrid.fleets.plan import Plan, read_plan
from hybrid.fleets.pooling import FEWEST, pooled
from hybrid.fleets.run import connected
from hybrid.fleets.store import Store, run_plan, write_rows
from hybrid.fleets.worker import OK

SHARED = 5  # arms of a period that tell what all arms share
_EFFICIENCY = 0.5  # degrees of freedom of the scatter, of each difference
_CLIPPED = 3.0  # standard deviations that a difference counts at most: a step is none
_STEP = 5.0  # standard deviations from which a difference is a step
_CHANCE = 3.0  # times 1/N: variance of a mean of N squares of successive differences
_SURE = 1.96
_CLEARLY = 4.0  # standard errors, of a load that changed along with a parameter
_COVARIATES = ("temperature", "load")


@dataclass(frozen=True)
class State:
    """One parameter of one joint of one arm, over time and against the fleet.

    Attributes:
        arm: Name of the arm.
        group: Arms that it is held against.
        joint: Name of the joint, or ``arm``.
        parameter: Effect and gain.
        unit: SI unit.
        days: Dates of the periods, as ordinals, shape (T,), [d].
        values: Deviation from the baseline, less what temperature, load and the fleet
            explain, shape (T,).
        std: Standard deviation of the values, shape (T,).
        baseline: What the baseline says.
        changes: Changes, in order of time.
        confounded: What changed along with it, or was not logged; empty if nothing.
        level: Where it stands.
        pooled: Best guess of where it stands, given the fleet, with the baseline.
        pooled_std: Standard deviation of that.
        unlike: Whether the arm is not like the others in it.
        limit: Largest change that the plan allows; infinite if none.
        crossing: Days from the last period until it passes the limit: median, and
            95 % interval; infinite if never.
    """

    arm: str
    group: str
    joint: str
    parameter: str
    unit: str
    days: Array
    values: Array
    std: Array
    baseline: float
    changes: tuple[Change, ...]
    confounded: str
    level: Level
    pooled: float
    pooled_std: float
    unlike: bool
    limit: float
    crossing: tuple[float, float, float]

    @property
    def score(self) -> float:
        """Largest score of its changes; 0 without one."""
        return max((abs(x.score) for x in self.changes), default=0.0)


@dataclass(frozen=True)
class Fleet:
    """What became of a fleet.

    Attributes:
        rows: Rows of all units.
        states: Every parameter of every arm.
        shared: What all arms did together, in words.
        arm_months: Months of all arms together.
    """

    rows: Sequence[Mapping[str, Any]]
    states: tuple[State, ...]
    shared: tuple[str, ...]
    arm_months: float

    @property
    def alarms(self) -> list[State]:
        """Parameters that changed, the surest first."""
        found = [x for x in self.states if x.changes]
        return sorted(found, key=lambda x: -x.score)

    @property
    def refused(self) -> list[Mapping[str, Any]]:
        """Units without a result, each with its reason."""
        return [x for x in self.rows if x["status"] in ("refused", "late", "lost")]


def fleet(
    plan: Plan | str | Path,
    out: str | Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    progress: Callable[[str], None] | None = None,
) -> Fleet:
    """Inspect, identify and compare all arms of a plan over time.

    Args:
        plan: The plan, or its file.
        out: Folder for the results of the units and ``fleet.parquet``; what is there
            already is not done again.
        scheduler: Address of a Dask scheduler; this machine's cores by default.
        workers: Processes here; one per core by default.
        progress: Told how far it is.

    Raises:
        HybridError: The plan says something that is not valid, or Dask is missing.
    """
    plan = plan if isinstance(plan, Plan) else read_plan(plan)
    out, tell = Path(out), progress or (lambda _: None)
    with connected(scheduler, workers or os.cpu_count() or 1) as client:
        rows = run_plan(plan, Store(out / "units"), client, tell)
    write_rows(out / "fleet.parquet", rows)
    return fleet_from_rows(plan, rows)


def fleet_from_rows(plan: Plan, rows: Sequence[Mapping[str, Any]]) -> Fleet:
    """What the rows of all units say together."""
    groups = {arm.name: arm.group for arm in plan.arms}
    limits = {arm.name: arm.limits for arm in plan.arms}
    tables: dict[tuple[str, str, str], list[Mapping[str, Any]]] = defaultdict(list)
    spans: dict[str, set[str]] = defaultdict(set)
    for row in rows:
        if row["status"] == OK:
            key = groups[row["arm"]], row["joint"], row["parameter"]
            tables[key].append(row)
            spans[row["arm"]].add(row["period"])
    months = sum(map(len, spans.values())) * plan.days / MONTH
    watched = {group: sum(g == group for g, _, _ in tables) for group, _, _ in tables}
    states: list[State] = []
    shared: list[str] = []
    if tables and not any(np.isfinite(x["temperature"] or np.nan) for x in rows):
        shared.append("no log has a temperature: season and ageing are confounded")
    for (group, _, _), own in sorted(tables.items()):
        series = _Series(own)
        size = series.y.shape[1], plan.days, watched[group]
        shared += series.remove_common(threshold(*size))
        states += series.states(group, threshold(*size, series.noise), limits)
    return Fleet(rows, tuple(states), tuple(shared), months)


class _Series:
    """One parameter of the arms of a group: A arms, T periods, NaN where missing."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self.arms = sorted({x["arm"] for x in rows})
        names = sorted({(x["day"], x["period"]) for x in rows})
        periods = list(dict.fromkeys(name for _, name in names))
        first = {name: day for day, name in reversed(names)}
        self.days = np.array([
            float(date.fromisoformat(first[x]).toordinal()) if first[x] else float(k)
            for k, x in enumerate(periods)
        ])  # fmt: skip
        self.row = rows[0]
        shape = len(self.arms), len(periods)
        at = {name: k for k, name in enumerate(self.arms)}
        when = {name: k for k, name in enumerate(periods)}
        self.y, self.s, self.baseline = np.full((3, *shape), np.nan)
        self.x = {name: np.full(shape, np.nan) for name in _COVARIATES}
        for row in rows:
            here = at[row["arm"]], when[row["period"]]
            self.y[here], self.s[here] = row["change"], row["std"]
            self.baseline[here] = row["baseline"]
            for name in _COVARIATES:
                self.x[name][here] = row[name]
        self.many = len(self.arms) >= SHARED

    @property
    def name(self) -> str:
        return f"{self.row['joint']}, {self.row['parameter']}"

    def remove_common(self, limit: float) -> Iterator[str]:
        """Take away what temperature, load and the whole fleet explain; say what."""
        if self.many:
            for name in _COVARIATES:
                self._remove_slope(name)
            level = np.nanmedian(self.y, axis=1, keepdims=True)
            counts = np.isfinite(self.y).sum(axis=0)
            common = np.where(counts >= SHARED, _median(self.y - level), 0.0)
            self.y = self.y - common
            self._scale()
            std = 1.2533 * np.nanmedian(self.s) / np.sqrt(np.maximum(counts, 1))
            for x in changes(self.days, common, std, limit=limit):
                yield (
                    f"{self.name}: all arms together, {_said(x, self.row['unit'])}; "
                    "season, ageing and a change of the measurement are confounded"
                )
        else:
            self._scale()

    def _remove_slope(self, name: str) -> None:
        seen = np.isfinite(self.x[name])
        x = self.x[name] - (self.x[name][seen].mean() if seen.any() else 0.0)
        slopes = []
        for own, y in zip(x, self.y, strict=True):
            seen = np.isfinite(own) & np.isfinite(y)
            off = own[seen] - own[seen].mean() if seen.any() else own[seen]
            if off @ off > 0:
                slopes.append(off @ y[seen] / (off @ off))
        if len(slopes) < SHARED:
            return
        slope = float(np.median(slopes))
        error = 1.2533 * median_abs_deviation(slopes, scale="normal")
        if abs(slope) > _SURE * error / np.sqrt(len(slopes)):
            self.y = self.y - slope * np.nan_to_num(x)

    def _scale(self) -> None:
        """Scatter between periods, from differences: steps and trends hardly count.

        That of one arm lies between its own and the fleet's, as far as arms differ by
        more than chance.
        """
        gaps = [_differences(y, s) for y, s in zip(self.y, self.s, strict=True)]
        every = np.concatenate(gaps)
        self.degrees = max(1.0, _EFFICIENCY * len(every))
        usual = 1.4826 * float(np.median(np.abs(every))) if len(every) else 1.0
        most = _CLIPPED * max(usual, 1e-9)
        own = np.array([np.mean(np.clip(x, -most, most) ** 2) if len(x) else np.nan
                        for x in gaps])  # fmt: skip
        mean = float(np.nanmean(own)) if len(every) else 1.0
        ratio = np.nan_to_num(own / max(mean, 1e-18), nan=1.0)
        chance = _CHANCE * float(np.mean([1 / max(len(x), 1) for x in gaps]))
        true = max(0.0, 1.0 - chance / max(float(np.var(ratio)), 1e-18))
        small = every[np.abs(every) < _STEP * usual]
        self.noise = small / max(float(small.std()), 1e-9) if len(small) else small
        self.s *= np.sqrt(max(mean, 1e-18) * (1.0 + true * (ratio - 1.0)))[:, None]

    def states(
        self, group: str, limit: float, limits: Mapping[str, Mapping[str, str | float]]
    ) -> Iterator[State]:
        """Every arm's state."""
        found = []
        for k in range(len(self.arms)):
            seen = np.isfinite(self.y[k]) & np.isfinite(self.s[k])
            t, y, s = self.days[seen], self.y[k, seen], self.s[k, seen]
            warm = self.x["temperature"][k, seen]
            known = not self.many and np.isfinite(warm).all() and np.ptp(warm) > 0
            options = {"limit": limit, "degrees": self.degrees}
            own = tuple(changes(t, y, s, x=warm if known else None, **options))
            now = level(t, y, s, own[-1] if own else None)
            found.append((k, t, y, s, own, now))
        base = np.nanmedian(self.baseline, axis=1)
        value = np.array([base[k] + now.value for k, *_, now in found])
        std = np.array([now.std for *_, now in found])
        fleet = pooled(value, std) if len(found) >= FEWEST else None
        for k, t, y, s, own, now in found:
            arm, most = self.arms[k], self._limit(limits[self.arms[k]], base[k])
            yield State(
                arm, group, self.row["joint"], self.row["parameter"], self.row["unit"],
                t, y, s, float(base[k]), own, self._confounded(k, own), now,
                float(fleet.value[k]) if fleet else float(value[k]),
                float(fleet.std[k]) if fleet else now.std,
                bool(fleet is not None and fleet.unlike[k]), most,
                crossing(now, most) if np.isfinite(most) else (np.inf, np.inf, np.inf),
            )  # fmt: skip

    def _limit(self, limits: Mapping[str, str | float], baseline: float) -> float:
        parameter = self.row["parameter"]
        given = limits.get(parameter, limits.get(parameter.partition(".")[0]))
        if given is None:
            return np.inf
        text = str(given)
        share = float(text.removesuffix("%")) / 100 * abs(baseline)
        return share if text.endswith("%") else float(text)

    def _confounded(self, k: int, own: Sequence[Change]) -> str:
        """What the changes of an arm cannot be told from."""
        found = []
        if own and not self.many and not np.isfinite(self.x["temperature"][k]).any():
            found.append("temperature, which is not logged")
        load = self.x["load"][k]
        seen = np.isfinite(load)
        gaps = np.diff(load[seen])
        noise = median_abs_deviation(gaps, scale="normal") / np.sqrt(2)
        for change in own:
            later = self.days >= change.day
            before, after = load[seen & ~later], load[seen & later]
            if len(before) and len(after):
                error = noise * np.sqrt(1 / len(before) + 1 / len(after))
                if abs(after.mean() - before.mean()) > _CLEARLY * error > 0:
                    found.append("load")
        return ", ".join(dict.fromkeys(found))


def _median(x: Array) -> Array:
    """Median over arms of each period, 0 where there is none."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0
                     for c in x.T])  # fmt: skip


def _differences(y: Array, s: Array) -> Array:
    """Differences of successive values, over their standard deviation."""
    seen = np.isfinite(y) & np.isfinite(s)
    y, s = y[seen], s[seen]
    return np.asarray(np.diff(y) / np.hypot(s[1:], s[:-1]))


def _said(x: Change, unit: str) -> str:
    when = date.fromordinal(max(1, int(x.day))).isoformat()
    if x.kind == "trend":
        return f"{MONTH * x.size:+.3g} {unit} a month since {when}"
    return f"{x.size:+.3g} {unit} on {when}"
