"""Table of the pairs that advised experiments were to split; see ``advice.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from blind.measures import Ratio

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results

COLUMNS = ("true", "rival", "joint", "seed", "promise", "split", "right", "separation")
SEEN = ("split", "right")
KINDS = {
    "told apart": "an experiment was said to tell them apart",
    "shown if there": "an experiment was said to show one of them, if it is there",
    "without a motion": "one law on every motion; what to do instead was said",
    "none": "no experiment of the menu tells them apart, and none was advised",
}


def write_report(out: Path, pairs: Sequence[Mapping[str, Any]], command: str) -> str:
    """Write the report and sum it up.

    Args:
        out: Folder for it.
        pairs: One mapping a pair of true effect and rival.
        command: What reproduces it.
    """
    kinds: dict[str, list[Mapping[str, Any]]] = {k: [] for k in KINDS}
    for p in pairs:
        kinds[kind(p)].append(p)
    counts = [
        (KINDS[k], str(len(rows)), *(_share(rows, x) for x in SEEN))
        for k, rows in kinds.items()
    ]
    counts.append(("all", str(len(pairs)), *(_share(pairs, x) for x in SEEN)))
    summary = markdown_table(
        Table(("pairs", "number", "split", "rightly"), tuple(counts))
    )
    rows = tuple((*(_cell(p, c) for c in COLUMNS), p["advice"]) for p in pairs)
    table = markdown_table(Table((*COLUMNS, "advice"), rows))
    content = {"provenance": provenance(command=command), "pairs": list(pairs)}
    write_results(out / "results.json", content)
    text = (
        "Pairs of the true effect and one that a short recording could not tell from "
        "it, before and after the true arm has run the advised experiment. *Split*: no "
        "longer in one class; *rightly*: and the true effect is still named. Shares "
        "with 95 % intervals of Wilson."
    )
    with atomic_path(out / "table.md") as path:
        path.write_text(f"{text}\n\n{summary}\n{table}\n    {command}\n", "utf-8")
    return summary


def kind(pair: Mapping[str, Any]) -> str:
    """What was promised of a pair."""
    if not pair["advice"]:
        return "none"
    if not pair["runs"]:
        return "without a motion"
    return "shown if there" if "; it shows " in pair["advice"] else "told apart"


def _share(pairs: Sequence[Mapping[str, Any]], key: str) -> str:
    if not any(p["runs"] for p in pairs):
        return "–"
    ratio = Ratio(sum(bool(p[key]) for p in pairs), len(pairs))
    low, high = (100 * x for x in ratio.interval)
    held = f"{ratio.hits}/{ratio.total}"
    return f"{100 * ratio.value:.0f} % ({low:.0f}–{high:.0f}; {held})"


def _cell(pair: Mapping[str, Any], column: str) -> str:
    x = kind(pair) if column == "promise" else pair.get(column, "–")
    if isinstance(x, bool):
        return "yes" if x else "no"
    return f"{x:.3g}" if isinstance(x, float) else str(x)
