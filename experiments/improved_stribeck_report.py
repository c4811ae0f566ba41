"""Tables and figure of ``improved_stribeck.py``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from improved_stribeck_figure import way_down
from improved_stribeck_solvers import solvers_table, together_table
from joint_friction_logs import NAMES
from outputs import captioned, write_tables
from rich.console import Console

from hybrid.report import save_figure, terminal_table
from hybrid.report.table import Table

PUBLISHED = {  # % of the error of the computed joint torque removed, joints 1–3
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


def _cuts(fits: dict[str, Any], simpler: str) -> list[float]:
    """Error that the improved law removes of a simpler one's, [%].

    Returns:
        Of the squares fitted, of those held out, of the RMS held out.
    """
    rich, plain = fits["improved"], fits[simpler]
    left = [rich[x] / plain[x] for x in ("squares", "check_squares")]
    return [100 * (1 - x) for x in (*left, np.sqrt(left[1]))]


def _removed(joints: Sequence[dict[str, Any]]) -> Table:
    rows, ripples = [], list(joints[0]["fits by ripple"])
    for simpler, published in PUBLISHED.items():
        for k, joint in enumerate(joints):
            each = (_cuts(x, simpler) for x in joint["fits by ripple"].values())
            cells = (" / ".join(f"{x:.1f}" for x in cuts) for cuts in each)
            rows.append((f"{simpler}, joint {k + 1}", *cells, str(published[k])))
    caption = (
        "Error that the improved law removes of a simpler one's [%]: squares fitted / "
        "squares held out / RMS held out, with torque ripple that no law knows, of "
        "this share of f_C"
    )
    return Table(("against", *ripples, "published"), tuple(rows), caption)


def _main_result(joints: Sequence[dict[str, Any]]) -> str:
    """The publication's main result, how it is read, and ours."""
    first = "Coulomb + viscous"
    parts = []
    for ripple in joints[0]["fits by ripple"]:
        cuts = [_cuts(joint["fits by ripple"][ripple], first) for joint in joints]
        ends = zip(np.min(cuts, axis=0), np.max(cuts, axis=0), strict=True)
        _, squares, rms = (f"{low:.1f} to {high:.1f} %" for low, high in ends)
        parts.append(f"at {ripple}, {squares} of the squares and {rms} of the RMS")
    low, high = min(PUBLISHED[first]), max(PUBLISHED[first])
    return (
        f"The publication's main result is {low} to {high} % less error of the "
        "computed joint torque than with Coulomb and viscous friction, on three joints "
        "of a real arm. It is a share of what that simpler law leaves. Whether of "
        "squares or of RMS, and how much no law explains there, is not known here; the "
        "share depends on the latter most of all. Ours, on a motion held out, by size "
        f"of the ripple: {'; '.join(parts)}.\n"
    )


def write_report(
    out: Path,
    joints: Sequence[dict[str, Any]],
    together: dict[str, Any],
    generations: int,
    options: str,
) -> None:
    """Print the tables and write them, the figure and the numbers."""
    command = f"python experiments/improved_stribeck.py {options}"
    console = Console(width=170)
    tables = [
        _recovered(joints),
        _removed(joints),
        solvers_table(joints, generations),
        together_table(together),
    ]
    texts = [captioned(t) for t in tables]
    texts.insert(2, _main_result(joints))
    for table in tables:
        console.print(terminal_table(table))
    console.print(texts[2])
    save_figure(way_down(joints), out / "figure.png")
    for found in (x for joint in joints for x in joint["searches"].values()):
        for run in (run for runs in found.values() for run in runs):
            run["history"] = run["history"][::25]  # the figure has drawn every step
    text = "\n".join(texts)
    write_tables(out, text, command, joints=joints, together=together)
