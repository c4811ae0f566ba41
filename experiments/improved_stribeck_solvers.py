"""Tables of ``improved_stribeck.py`` on solvers, and on all joints at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from joint_friction_logs import NAMES

from hybrid.report.table import Table

PUBLISHED = "10.76, 19.66, 0.0385, 24.03"  # on its own logs
SEARCHES = ("genetic", "annealed")


def solvers_table(joints: Sequence[dict[str, Any]], generations: int) -> Table:
    """Squares, generations and time of every solver against ours."""
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
                steps = f"{np.median(taken):.0f}" if name in SEARCHES else ""
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
                rows.append((f"{k} {law}: {name}", ratio, steps,
                    f"{runs[0]['evaluations']:,}",
                    "" if np.isnan(time) else f"{time:.0f}", point))  # fmt: skip
            if law == "Stribeck":
                rows.append((f"{k} {law}: published, 3 solvers", *4 * [""], PUBLISHED))
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


def together_table(found: dict[str, Any]) -> Table:
    """True and found parameters of all joints."""
    rows = []
    for j, (true, x, ends) in enumerate(
        zip(found["true"], found["x"], found["interval"], strict=True), 1
    ):
        cells = [
            f"{a:.4g} → {b:.4g} ± {(e[1] - e[0]) / 2:.1g}"
            for a, b, e in zip(true, x, ends, strict=True)
        ]
        rows.append((str(j), *cells))
    low, high = np.moveaxis(np.array(found["interval"]), -1, 0)
    inside = np.mean((low <= found["true"]) & (found["true"] <= high))
    caption = (
        "Ours, all joints moving, rigid body unknown: true → found; "
        f"{inside:.0%} of the true values in their 95 % interval"
    )
    return Table(("joint", *NAMES), tuple(rows), caption)
