"""One parameter of the arms of a group over time: covariates, changes, outliers.

``value = level of the arm + slope · (temperature, load) + common change of all arms in
a period + own change + noise``. Slopes and common changes are medians over all arms, so
faulty arms have no influence. The noise comes from differences between successive
periods, see :mod:`hybrid.fleets.scatter`. Own changes are detected in the rest, see
:mod:`hybrid.fleets.changes`.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.fleets.changes import MONTH, Change, Level, changes, crossing, level
from hybrid.fleets.pooling import FEWEST, pooled
from hybrid.statistics import HALF_WIDTH

SHARED = 5  # fewest arms for a common change
_OF_MEDIAN = 1.2533  # standard error of a median over that of a mean
_LOAD_CHANGED = 4.0  # standard errors from which a change of load is named
_COVARIATES = ("temperature", "load")


@dataclass(frozen=True)
class State:
    """One parameter of one joint of one arm, over time and compared with the fleet.

    Attributes:
        arm: Name of the arm.
        group: Name of the group of arms.
        joint: Name of the joint, or ``arm``.
        parameter: Effect and gain.
        unit: SI unit.
        days: Dates of the periods, as ordinals, shape (T,), [d].
        values: Deviation from the baseline, corrected for temperature, load and common
            changes of the fleet, shape (T,).
        std: Standard deviation of the values, shape (T,).
        baseline: Value in the baseline.
        changes: Changes, in order of time.
        confounded: Quantities that changed at the same time, or were not logged.
        level: The last value.
        pooled: Last value, baseline included, shrunk towards the fleet's mean.
        unlike: Whether the arm is an outlier of its group.
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
    unlike: bool
    limit: float
    crossing: tuple[float, float, float]

    @property
    def score(self) -> float:
        """Largest score of its changes; 0 without one."""
        return max((abs(x.score) for x in self.changes), default=0.0)


class Series:
    """One parameter of the arms of a group: A arms, T periods, NaN where missing."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self.arms = sorted({x["arm"] for x in rows})
        dated = sorted({(x["day"], x["period"]) for x in rows})
        periods = list(dict.fromkeys(name for _, name in dated))
        first = {name: day for day, name in reversed(dated)}
        self.days = np.array([
            float(date.fromisoformat(first[x]).toordinal()) if first[x] else float(k)
            for k, x in enumerate(periods)
        ])  # fmt: skip
        self.row = rows[0]
        shape = len(self.arms), len(periods)
        at = {name: k for k, name in enumerate(self.arms)}
        when = {name: k for k, name in enumerate(periods)}
        names = "change", "std", "baseline", *_COVARIATES
        self.x = {name: np.full(shape, np.nan) for name in names}
        for row in rows:
            for name, values in self.x.items():
                values[at[row["arm"]], when[row["period"]]] = row[name]
        self.y, self.s, self.baseline = map(self.x.pop, names[:3])
        self.many = len(self.arms) >= SHARED

    def remove_common(self) -> None:
        """Correct for temperature, load and common changes of the fleet."""
        self.common = np.zeros(self.y.shape[1])
        if not self.many:
            return
        for name in _COVARIATES:
            self._remove_slope(name)
        counts = np.isfinite(self.y).sum(axis=0)
        level = np.nanmedian(self.y, axis=1, keepdims=True)
        known = counts >= SHARED
        self.common[known] = np.nanmedian((self.y - level)[:, known], axis=0)
        self.y = self.y - self.common

    def shared(self, limit: float) -> Iterator[str]:
        """Changes of all arms together, in words."""
        counts = np.isfinite(self.y).sum(axis=0)
        std = _OF_MEDIAN * np.nanmedian(self.s) / np.sqrt(np.maximum(counts, 1))
        for x in changes(self.days, self.common, std, limit=limit):
            yield (
                f"{self.row['joint']}, {self.row['parameter']}: all arms together, "
                f"{_sentence(x, self.row['unit'])}; "
                "season, ageing and a change of the measurement are confounded"
            )

    def _remove_slope(self, name: str) -> None:
        from scipy.stats import median_abs_deviation

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
        error = _OF_MEDIAN * median_abs_deviation(slopes, scale="normal")
        if abs(slope) > HALF_WIDTH * error / np.sqrt(len(slopes)):
            self.y = self.y - slope * np.nan_to_num(x)

    def states(
        self,
        group: str,
        freedom: Array,
        limit: float,
        limits: Mapping[str, Mapping[str, str | float]],
    ) -> Iterator[State]:
        """The state of every arm.

        The standard deviations have some degrees of freedom, shape (A,); ``limit`` is
        the score of an alarm, and ``limits`` are the largest changes, by arm.
        """
        found = []
        for k in range(len(self.arms)):
            seen = np.isfinite(self.y[k]) & np.isfinite(self.s[k])
            t, y, s = self.days[seen], self.y[k, seen], self.s[k, seen]
            warm = self.x["temperature"][k, seen]
            known = not self.many and np.isfinite(warm).all() and np.ptp(warm) > 0
            options = {"limit": limit, "degrees": float(freedom[k])}
            own = tuple(changes(t, y, s, x=warm if known else None, **options))
            now = level(t, y, s, own[-1] if own else None)
            found.append((k, t, y, s, own, now))
        base = np.nanmedian(self.baseline, axis=1)
        value = np.array([base[k] + now.value for k, *_, now in found])
        std = np.array([now.std for *_, now in found])
        unlike = np.zeros(len(found), dtype=bool)
        if len(found) >= FEWEST:
            value, unlike = pooled(value, std)
        for k, t, y, s, own, now in found:
            arm, most = self.arms[k], self._limit(limits[self.arms[k]], base[k])
            yield State(
                arm, group, self.row["joint"], self.row["parameter"], self.row["unit"],
                t, y, s, float(base[k]), own, self._confounded(k, own), now,
                float(value[k]), bool(unlike[k]), most,
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
        """Other explanations of an arm's changes, in words."""
        from scipy.stats import median_abs_deviation

        if not own:
            return ""
        found = []
        if not self.many and not np.isfinite(self.x["temperature"][k]).any():
            found.append("temperature, which is not logged")
        load = self.x["load"][k]
        seen = np.isfinite(load)
        differences = np.diff(load[seen])
        noise = median_abs_deviation(differences, scale="normal") / np.sqrt(2)
        for change in own:
            later = self.days >= change.day
            before, after = load[seen & ~later], load[seen & later]
            if len(before) and len(after):
                error = noise * np.sqrt(1 / len(before) + 1 / len(after))
                if abs(after.mean() - before.mean()) > _LOAD_CHANGED * error > 0:
                    found.append("load")
        return ", ".join(dict.fromkeys(found))


def _sentence(x: Change, unit: str) -> str:
    if x.kind == "trend":
        return f"{MONTH * x.size:+.3g} {unit} a month since {day_text(x.day)}"
    return f"{x.size:+.3g} {unit} on {day_text(x.day)}"


def day_text(ordinal: float) -> str:
    """ISO date of an ordinal; the number of the log if dates are not known."""
    if ordinal < 366:
        return f"log {ordinal:.0f}"
    return date.fromordinal(int(ordinal)).isoformat()
