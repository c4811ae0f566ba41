"""Table of the pairs that advised experiments were to split; see ``advice.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results

REPORT = Path(__file__).parents[1] / "reports" / "advice"
COLUMNS = ("true", "rival", "joint", "size", "seed", "separation", "split", "right")


def write_report(pairs: Sequence[Mapping[str, Any]], command: str) -> str:
    """Write ``reports/advice/`` and sum it up in a sentence.

    Args:
        pairs: One mapping a pair of true effect and rival.
        command: What reproduces it.
    """
    run = [p for p in pairs if p["runs"]]
    split, right = (sum(p[key] for p in run) for key in ("split", "right"))
    caption = (
        f"Of {len(run)} pairs of a true effect and a rival, {split} are split by the "
        f"advised experiment, {right} of them with the true effect named. "
        f"{len(pairs) - len(run)} more have one law on every motion, and no motion is "
        "advised"
    )
    rows = tuple((*(_text(p[c]) for c in COLUMNS), p["advice"]) for p in pairs)
    table = markdown_table(Table((*COLUMNS, "advice"), rows))
    content = {"provenance": provenance(command=command), "pairs": list(pairs)}
    write_results(REPORT / "results.json", content)
    with atomic_path(REPORT / "table.md") as path:
        path.write_text(f"{caption}.\n\n{table}\n    {command}\n", encoding="utf-8")
    return caption


def _text(x: Any) -> str:
    if isinstance(x, bool):
        return "yes" if x else "no"
    return f"{x:.3g}" if isinstance(x, float) else str(x)
