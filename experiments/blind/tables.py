"""The benchmark's tables, and its folder of results."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.confusion import confusion_figure
from blind.measures import (
    MEASURES,
    Ratio,
    Row,
    as_method,
    class_size,
    confusion,
    coverage,
    scored,
    shares,
    size,
)
from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, save_figure, write_results

METHODS = ("ranking", "stepwise", "stlsq", "fixed", "sysid")
_NAMES = {
    "ranking": "plain ranking by shrinkage",
    "stepwise": "stepwise, iid F-test",
    "stlsq": "sparse regression (STLSQ)",
    "fixed": "fixed structure",
    "sysid": "fixed structure, mujoco.sysid",
}
_RIGHT = MEASURES[0]

Groups = Mapping[str, Sequence[Row]]


def by_robot(rows: Sequence[Row], tuned: Sequence[str]) -> Groups:
    """Rows of robots used for tuning, of all others together, and of each of these.

    Args:
        rows: Rows of the benchmark.
        tuned: Short names of robots that thresholds were tuned on.
    """
    arms = sorted({row["arm"] for row in rows})
    known = [arm for arm in arms if arm in tuned]
    new = [arm for arm in arms if arm not in tuned]
    groups = {arm: [r for r in rows if r["arm"] == arm] for arm in known}
    if len(new) > 1:
        groups["robots never tuned on"] = [r for r in rows if r["arm"] in new]
    return groups | {arm: [r for r in rows if r["arm"] == arm] for arm in new}


def targets_table(groups: Groups) -> Table:
    """Every measure with its target, group by group."""
    rows = [
        (m.name, m.wanted, *(_share(m.of(r)) for r in groups.values()))
        for m in MEASURES
    ]
    others: tuple[tuple[str, str, Callable[[Sequence[Row]], str]], ...] = (
        ("mean size of the class, ≥ 1×", "≤ 1.5", lambda r: _number(class_size(r))),
        ("part of the oracle's shrinkage of torque, median", "≥ 0.97",
         lambda r: _quantile(shares(r), 0.5)),
        ("the same, 10th percentile", "≥ 0.80", lambda r: _quantile(shares(r), 0.1)),
        ("part of the oracle's shrinkage of motion, median", "≥ 0.93",
         lambda r: _quantile(shares(r, of="motion"), 0.5)),
        ("the same, 10th percentile, motion", "≥ 0.80",
         lambda r: _quantile(shares(r, of="motion"), 0.1)),
        ("95 % intervals with the truth", "92–97 %", lambda r: _share(coverage(r))),
        ("processor time, median (largest), s", "", _seconds),
        ("cases (crashes)", "", lambda r: f"{len(r)} ({_crashes(r)})"),
    )  # fmt: skip
    for name, wanted, cell in others:
        cells = [cell(r if "crashes" in name else scored(r)) for r in groups.values()]
        rows.append((name, wanted, *cells))
    return Table(("", "target", *groups), tuple(rows), "Shares with 95 % intervals")


def methods_table(rows: Sequence[Row]) -> Table:
    """The diagnosis beside simpler methods that had the same columns and recordings."""
    ran = [m for m in METHODS if all(m in r["baselines"] for r in rows)]
    answers = {"diagnosis": rows, **{_NAMES[m]: as_method(rows, m) for m in ran}}
    lines = [
        (m.name, *(_share(m.of(r)) for r in answers.values()), "")
        for m in MEASURES
        if m.of(rows).total and not m.of_verdict
    ]
    black = _quantile(shares(rows, "black_box_share"), 0.5)
    ours = _quantile(shares(rows), 0.5)
    none = [""] * len(ran)
    lines.append(
        ("part of the oracle's shrinkage of torque, median", ours, *none, black)
    )
    return Table(("", *answers, "black box"), tuple(lines), "The same cases, by method")


def strata_table(rows: Sequence[Row]) -> Table:
    """The first measure by what a plant and its recordings are like."""
    lines = []
    for name, of in _CUTS.items():
        for value in sorted({of(row) for row in rows}):
            ratio = _RIGHT.of([row for row in rows if of(row) == value])
            if ratio.total:
                lines.append((name, value, _share(ratio)))
    return Table(("", "", _RIGHT.name), tuple(lines), "One effect, by stratum")


def _range(x: float, edges: Sequence[float], unit: str) -> str:
    """The part between edges that a number lies in."""
    k = int(np.searchsorted(edges, x, side="right"))
    if k == 0:
        return f"below {edges[0]:g}{unit}"
    top = f"–{edges[k]:g}" if k < len(edges) else " and more,"
    return f"{edges[k - 1]:g}{top}{unit}"


_CUTS: Mapping[str, Callable[[Row], str]] = {
    "size": lambda r: _range(size(r), (0.85, 2.0, 6.0), " ×"),
    "noise": lambda r: f"{r['truth']['recipe']['noise']:g}×",
    "file's numbers off by": lambda r: _range(
        100 * r["truth"]["recipe"]["off"], (0.0, 1.0, 2.0, 3.5, 5.0), " %"
    ),
    "recordings": lambda r: f"{r['truth']['recipe']['recordings']}",
    "integrator": lambda r: r["truth"]["recipe"]["integrator"],
    "effect": lambda r: ", ".join(e["means"] for e in r["truth"]["effects"]),
}


def write_benchmark(
    rows: Sequence[Row],
    directory: Path,
    *,
    tuned: Sequence[str],
    how: Mapping[str, Any],
) -> dict[str, Any]:
    """Write ``tables.md``, ``results.json`` and ``confusion.png``.

    Args:
        rows: Rows of the benchmark.
        directory: Where to.
        tuned: Short names of robots that thresholds were tuned on.
        how: How the rows came about; ``command`` reproduces them.

    Returns:
        Content of ``results.json``: each measure as number of cases in which it held,
        and of cases that count, by group of robots; and each case in short.
    """
    rows = [row for row in rows if "skipped" not in row]
    answered, groups = scored(rows), by_robot(rows, tuned)
    tables = targets_table(groups), methods_table(answered), strata_table(answered)
    parts = [f"## {t.caption}\n\n{markdown_table(t)}" for t in tables if t.rows]
    with atomic_path(directory / "tables.md") as path:
        text = "\n".join([*parts, f"    {how['command']}\n"])
        path.write_text(text, encoding="utf-8")
    save_figure(confusion_figure(confusion(answered)), directory / "confusion.png")
    counted = {
        name: {m.name: [(x := m.of(part)).hits, x.total] for m in MEASURES}
        for name, part in groups.items()
    }
    content = {
        "provenance": how,
        "tuned": tuned,
        "measures": counted,
        "cases": [_line(row) for row in rows],
    }
    write_results(directory / "results.json", content)
    return content


def _line(row: Row) -> dict[str, Any]:
    """A case in short: its seed tells all the rest."""
    line = {k: row[k] for k in ("robot", "stratum", "index", "seed")}
    if "truth" not in row:
        return line | {"crashed": row["crashed"]}
    true = [[e["effect"], *e["joints"]] for e in row["truth"]["effects"]]
    kept = {k: row[k] for k in ("verdict", "named", "false")}
    share = row.get("shrinkage", {}).get("share")
    return {**line, "true": true, "size": round(size(row), 2), **kept, "share": share}


def _share(ratio: Ratio) -> str:
    if ratio.total == 0:
        return "–"
    low, high = (100 * x for x in ratio.interval)
    return (
        f"{100 * ratio.value:.0f} % ({low:.0f}–{high:.0f}; {ratio.hits}/{ratio.total})"
    )


def _number(x: float) -> str:
    return f"{x:.2f}" if math.isfinite(x) else "–"


def _quantile(values: Sequence[float], level: float) -> str:
    return f"{np.quantile(values, level):.2f} ({len(values)})" if values else "–"


def _seconds(rows: Sequence[Row]) -> str:
    times = [row["cpu_s"] for row in rows]
    return f"{np.median(times):.1f} ({max(times):.1f})" if times else "–"


def _crashes(rows: Sequence[Row]) -> int:
    return sum("crashed" in row for row in rows)
