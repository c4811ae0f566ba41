"""Tables and figure of ``improved_stribeck.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from improved_stribeck_figure import way_down
from improved_stribeck_solvers import solvers_table, together_table
from joint_friction_logs import NAMES
from rich.console import Console

from hybrid.files import atomic_path
from hybrid.report import numbers_table, provenance, save_figure, write_results
from hybrid.report.table import Table, markdown_table

PUBLISHED = {  # % of squares removed, joints 1–3
    "Coulomb + viscous": (28.6, 17.7, 33.6),
    "Stribeck": (16.3, 11.8, 17.3),
}


def _recovered(joints: Sequence[dict[str, Any]]) -> Table:
    rows = []
    for k, joint in enumerate(joints, 1):
        low, high = joint["fits"]["improved"]["interval"]
        found = np.median(
            [r["x"] for r in joint["searches"]["improved"]["annealed"]], 0
        )
        ours = joint["fits"]["improved"]["x"]
        ends = [f"{a:.4g} to {b:.4g}" for a, b in zip(low, high, strict=True)]
        for name, values in (
            ("true", joint["true"]),
            ("annealed", found),
            ("ours", ours),
        ):
            rows.append((f"{k} {name}", *(f"{x:.4g}" for x in values)))
        rows.append((f"{k} ours, 95 %", *ends))
    caption = "Recovered parameters [N·m, rad/s], one joint moving; annealed: median"
    return Table(("joint", *NAMES), tuple(rows), caption)


def _removed(joints: Sequence[dict[str, Any]]) -> Table:
    rows, ripples = [], list(joints[0]["fits by ripple"])
    for simpler, published in PUBLISHED.items():
        for k, joint in enumerate(joints):
            cells = []
            for fits in joint["fits by ripple"].values():
                rich, plain = fits["improved"], fits[simpler]
                cuts = [1 - rich[x] / plain[x] for x in ("squares", "check_squares")]
                cells.append(" / ".join(f"{100 * x:.1f}" for x in cuts))
            rows.append((f"{simpler}, joint {k + 1}", *cells, str(published[k])))
    caption = (
        "Squares that the improved law removes of a simpler one's [%], fitted / held "
        "out, with torque ripple that no law knows, of this share of f_C"
    )
    return Table(("against", *ripples, "published"), tuple(rows), caption)


def write_report(
    out: Path,
    joints: Sequence[dict[str, Any]],
    together: dict[str, Any],
    generations: int,
    options: str,
) -> None:
    """Print the tables and write them, the figure and the numbers."""
    command, console = (
        f"python experiments/improved_stribeck.py {options}",
        Console(width=170),
    )
    tables = [
        _recovered(joints),
        _removed(joints),
        solvers_table(joints, generations),
        together_table(together),
    ]
    for table in tables:
        console.print(numbers_table(table))
    save_figure(way_down(joints), out / "figure.png")
    with atomic_path(out / "table.md") as path:
        path.write_text(
            "\n".join(f"{t.caption}.\n\n{markdown_table(t)}" for t in tables)
            + f"\n    {command}\n"
        )
    for found in (x for joint in joints for x in joint["searches"].values()):
        for run in (run for runs in found.values() for run in runs):
            run["history"] = run["history"][::25]  # the figure has drawn every step
    write_results(
        out / "results.json",
        {
            "provenance": provenance(command=command),
            "joints": joints,
            "together": together,
        },
    )
