"""What is counted over many cases, and what it should come to."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from blind.score import EQUIVALENT
from hybrid.diagnosis.prior import Prior

Row = Mapping[str, Any]

_NORMAL = 1.96
_SMALL, _LARGE = 0.6, 0.85  # sizes that count as "0.3×" lie below, as "1×" above


@dataclass(frozen=True)
class Ratio:
    """How often something held, of how many cases."""

    hits: int
    total: int

    @property
    def value(self) -> float:
        """Share; NaN of no case."""
        return self.hits / self.total if self.total else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share.

        Source: Wilson 1927, doi 10.1080/01621459.1927.10502953.
        """
        n, p, z = self.total, self.value, _NORMAL
        if n == 0:
            return 0.0, 1.0
        middle = (p + z**2 / (2 * n)) / (1 + z**2 / n)
        half = z * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2)) / (1 + z**2 / n)
        # The share lies inside whatever the rounding.
        return max(0.0, min(p, middle - half)), min(1.0, max(p, middle + half))


@dataclass(frozen=True)
class Measure:
    """A share of cases with its target.

    Attributes:
        name: What is counted.
        counts: Whether a case belongs to the total.
        holds: Whether it holds there.
        target: Share to be reached.
        most: Whether the target is the most that is allowed, instead of the least.
        of_verdict: Whether only a diagnosis can say it, and no other method.
    """

    name: str
    counts: Callable[[Row], bool]
    holds: Callable[[Row], bool]
    target: float | None = None
    most: bool = False
    of_verdict: bool = False

    def of(self, rows: Sequence[Row]) -> Ratio:
        """The share over some rows."""
        counted = [row for row in scored(rows) if self.counts(row)]
        return Ratio(sum(map(self.holds, counted)), len(counted))

    @property
    def wanted(self) -> str:
        """The target as text."""
        if self.target is None:
            return ""
        return f"{'≤' if self.most else '≥'} {100 * self.target:.0f} %"


def size(row: Row) -> float:
    """Size of the smallest effect of a case at the joint where it is largest."""
    sizes = [max(e["sizes"], default=0.0) for e in row["truth"]["effects"]]
    return min(sizes, default=0.0)


def scored(rows: Sequence[Row]) -> list[Row]:
    """Rows of cases that could be made and were answered."""
    return [row for row in rows if "truth" in row]


def _in(*strata: str) -> Callable[[Row], bool]:
    return lambda row: row["stratum"] in strata


def _large(*strata: str) -> Callable[[Row], bool]:
    return lambda row: row["stratum"] in strata and size(row) >= _LARGE


def _small(row: Row) -> bool:
    return row["stratum"] == "single" and 0 < size(row) <= _SMALL


def _shrinks(row: Row) -> bool:
    """Whether the true effect alone is more than the file's numbers can stand for."""
    return row.get("shrinkage", {}).get("share") is not None


def _shows(row: Row) -> bool:
    """Whether the truth, with its true shapes, has the evidence that a term needs.

    Where nothing was named and it has not, no search of these recordings would name it.
    """
    ahead = row.get("shrinkage", {}).get("ahead")
    return bool(row["named"]) or ahead is None or ahead >= Prior().cause


def _unlike_any(row: Row) -> bool:
    return not any(e["means"] in EQUIVALENT for e in row["truth"]["effects"])


def _answers(row: Row) -> bool:
    return bool(row["named"])


def _silent(row: Row) -> bool:
    return not row["named"]


def _wrong(row: Row) -> bool:
    return bool(row["false"])


def _placed(row: Row) -> bool:
    """Whether the largest part of the gap is said to be at a joint of the truth."""
    joints = {j for e in row["truth"]["effects"] for j in e["joints"]}
    return row["where"][0] in joints


MEASURES = (
    Measure(
        "right cause first, in its class, ≥ 1×",
        _large("single"), lambda r: r["in_class"], 0.95,
    ),
    Measure(
        "the same, where the truth shrinks the gap on unseen motions",
        lambda r: _large("single")(r) and _shrinks(r), lambda r: r["in_class"],
    ),
    Measure("the same, ≥ 1×, strict", _large("single"), lambda r: r["strict"], 0.88),
    Measure("right cause first, 0.3×", _small, lambda r: r["in_class"], 0.75),
    Measure(
        "the same, where the truth shows in the recordings",
        lambda r: _small(r) and _shows(r), lambda r: r["in_class"], of_verdict=True,
    ),
    Measure(
        "joint localised, of those that name something, ≥ 1×",
        lambda r: _large("single")(r) and _answers(r), lambda r: r["localised"], 0.98,
    ),
    Measure("abstains, ≥ 1×", _large("single"), _silent, 0.05, most=True),
    Measure("false alarm, no effect at all", _in("none"), _answers, 0.01, most=True),
    Measure(
        "the same: says that something is there",
        _in("none"), lambda r: r["verdict"] != "no_gap", of_verdict=True,
    ),
    Measure(
        "effect withheld: abstains or names an equivalent, ≥ 1×",
        _large("withheld"), lambda r: r["declared"], 0.95,
    ),
    Measure("the same: abstains", _large("withheld"), _silent, 0.85),
    Measure(
        "the same, of effects to which none is declared equivalent",
        lambda r: _large("withheld")(r) and _unlike_any(r), _silent,
    ),
    Measure("no file describes it: abstains, ≥ 1×", _large("unknown"), _silent, 0.85),
    Measure(
        "its place, withheld or in no file",
        lambda r: _large("withheld", "unknown")(r) and bool(r["where"]), _placed,
        of_verdict=True,
    ),
    Measure(
        "two effects: both found, each ≥ 1×",
        _large("pair"), lambda r: r["found"] == 2, 0.85,
    ),
    Measure("two effects: any false cause", _large("pair"), _wrong, 0.05, most=True),
    Measure(
        "three effects: all found, each ≥ 1×",
        _large("triple"), lambda r: r["found"] == 3,
    ),
    Measure("three effects: any false cause", _large("triple"), _wrong),
    Measure(
        "independent physics: right cause first, ≥ 1×",
        _large("independent"), lambda r: r["in_class"],
    ),
    Measure(
        "independent physics, strict", _large("independent"), lambda r: r["strict"]
    ),
    Measure("independent physics: any false cause", _large("independent"), _wrong),
    Measure("independent physics: abstains", _large("independent"), _silent),
    Measure("poor excitation: any false cause", _in("poor"), _wrong),
    Measure("effect of the command alone: any false cause", _in("command"), _wrong),
)  # fmt: skip


def coverage(rows: Sequence[Row]) -> Ratio:
    """How often a 95 % interval of a gain held the true value."""
    inside, total = np.sum([r["covered"] for r in rows] or [(0, 0)], axis=0)
    return Ratio(int(inside), int(total))


def shares(
    rows: Sequence[Row], name: str = "share", of: str = "shrinkage"
) -> list[float]:
    """Parts of the oracle's shrinkage on unseen motions, of effects of ≥ 1×.

    Args:
        rows: Rows of the benchmark.
        name: Whose part.
        of: ``shrinkage`` of torque, or ``motion``.
    """
    chosen = [r for r in rows if r.get(of) and size(r) >= _LARGE]
    known = [r[of][name] for r in chosen if r["stratum"] != "withheld"]
    return [x for x in known if x is not None]


def class_size(rows: Sequence[Row]) -> float:
    """Mean number of effects in the class of the first cause, effects of ≥ 1×."""
    sizes = [r["class_size"] for r in rows if _large("single")(r) and r["named"]]
    return float(np.mean(sizes)) if sizes else math.nan


def as_method(rows: Sequence[Row], method: str) -> list[Row]:
    """The rows as if another method had answered."""
    return [{**row, **row["baselines"][method]} for row in rows]


def confusion(rows: Sequence[Row]) -> Counter[tuple[str, str]]:
    """How often each effect alone, ≥ 1×, was named what; ``nothing`` on either side."""
    counted: Counter[tuple[str, str]] = Counter()
    for row in rows:
        if _in("none")(row) or _large("single", "independent")(row):
            true = [e["means"] for e in row["truth"]["effects"]] or ["nothing"]
            named = row["named"][0][0] if row["named"] else "nothing"
            counted[true[0], named] += 1
    return counted
