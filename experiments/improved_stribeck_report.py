"""Tables and figure of ``improved_stribeck.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from joint_friction_logs import NAMES, ROOT
from rich.console import Console

from hybrid.files import atomic_path
from hybrid.report import numbers_table, provenance, save_figure, write_results
from hybrid.report.style import BLACK, BLUE, GREY, RED, clean, legend, new_figure
from hybrid.report.table import Table, markdown_table

REPORT = ROOT / "reports" / "improved_stribeck"
PUBLISHED = ((28.6, 17.7, 33.6), (16.3, 11.8, 17.3))  # % of squares removed, joints 1-3
INK = {"genetic": GREY, "annealed": RED}


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
    rows = []
    for simpler, published in zip(
        ("Coulomb + viscous", "Stribeck"), PUBLISHED, strict=True
    ):
        for k, joint in enumerate(joints):
            rich, plain = joint["fits"]["improved"], joint["fits"][simpler]
            cuts = [1 - rich[x] / plain[x] for x in ("squares", "check_squares")]
            shares = [f"{100 * x:.1f} %" for x in cuts]
            rows.append((f"{simpler}, joint {k + 1}", *shares, f"{published[k]} %"))
    caption = "Squares that the improved law removes of a simpler one's"
    return Table(("against", "fitted", "held out", "published"), tuple(rows), caption)


def _solvers(joints: Sequence[dict[str, Any]], generations: int) -> Table:
    rows = []
    for k, joint in enumerate(joints, 1):
        for law, solvers in joint["searches"].items():
            ours = joint["fits"][law]
            point = ", ".join(f"{x:.4g}" for x in ours["x"])
            rows.append(
                (f"{k} {law}: ours", "1", "", str(ours["evaluations"]), "1", point)
            )
            for name, runs in solvers.items():
                worst = [r["history"][-1] / ours["squares"] for r in runs]
                taken = [r.get("generations") or np.inf for r in runs]
                steps = f"{np.median(taken):.0f}" if name in INK else ""
                reached = f" ({np.isfinite(taken).sum()}/{len(runs)})" if steps else ""
                steps = steps.replace("inf", f">{generations}") + reached
                time = (
                    np.median([r.get("seconds", np.nan) for r in runs])
                    / ours["seconds"]
                )
                point = ", ".join(
                    f"{x:.4g}" for x in np.median([r["x"] for r in runs], 0)
                )
                ratio = f"{np.median(worst):.4f} ({max(worst):.3f})"
                rows.append((f"{k} {law}: {name}", ratio, steps, "",
                    "" if np.isnan(time) else f"{time:.0f}", point))  # fmt: skip
    caption = "Solvers: squares over ours, median (worst); generations to within 1 %"
    header = (
        "joint, law",
        "squares",
        "generations (reached)",
        "evaluations",
        "time",
        "parameters",
    )
    return Table(header, tuple(rows), caption)


def _together(found: dict[str, Any]) -> Table:
    rows = []
    for j, (true, x, ends) in enumerate(
        zip(found["true"], found["x"], found["interval"], strict=True), 1
    ):
        cells = [
            f"{a:.4g} → {b:.4g} ± {(e[1] - e[0]) / 2:.1g}"
            for a, b, e in zip(true, x, ends, strict=True)
        ]
        rows.append((str(j), *cells))
    inside = np.mean(
        [
            e[0] <= t <= e[1]
            for a, b in zip(found["true"], found["interval"], strict=True)
            for t, e in zip(a, b, strict=True)
        ]
    )
    caption = f"Ours, all joints moving, rigid body unknown: true → found; {inside:.0%} of the true values in their 95 % interval"
    return Table(("joint", *NAMES), tuple(rows), caption)


def write_report(
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
        _solvers(joints, generations),
        _together(together),
    ]
    for table in tables:
        console.print(numbers_table(table))
    figure = new_figure(height=2.6)
    for k, (axes, joint) in enumerate(
        zip(figure.subplots(1, 3), joints, strict=True), 1
    ):
        clean(axes, grid="both")
        for name, ink in INK.items():
            for run in joint["searches"]["improved"][name]:
                (line,) = axes.loglog(
                    run["history"] / joint["fits"]["improved"]["squares"],
                    color=ink,
                    linewidth=0.9,
                )
            line.set_label(name)
        axes.axhline(1.0, color=BLUE, linewidth=1.2, label="separable least squares")
        axes.set_title(f"joint {k}", loc="left", fontsize=9, color=BLACK)
        axes.set_xlabel("generation")
    figure.axes[0].set_ylabel("squares / ours")
    legend(figure, figure.axes[0].get_legend_handles_labels()[0])
    save_figure(figure, REPORT / "figure.png")
    with atomic_path(REPORT / "table.md") as path:
        path.write_text(
            "\n".join(f"{t.caption}.\n\n{markdown_table(t)}" for t in tables)
            + f"\n    {command}\n"
        )
    write_results(
        REPORT / "results.json",
        {
            "provenance": provenance(command=command),
            "joints": joints,
            "together": together,
        },
    )
