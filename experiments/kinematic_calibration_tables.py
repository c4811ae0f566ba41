"""Tables of ``kinematic_calibration.py``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mh6 import LABELS, LENGTH, PUBLISHED, SHOWN, TRUE, pose_errors

from hybrid.calibration import Measurements
from hybrid.calibration.solve import KinematicSolution
from hybrid.report.table import Table

USED = "tabu 3%"  # the radius that was taken; see kinematic_calibration.py
Runs = Sequence[Mapping[str, Any]]


def errors_table(runs: Runs, solution: KinematicSolution) -> Table:
    """The 24 errors: true, published, found by either solver."""
    found = np.median([run[USED]["x"] for run in runs], axis=0)
    columns = np.stack([TRUE, PUBLISHED, found, solution.x]) * SHOWN
    rows = [
        (label, "mm" if LENGTH[k] else "1e-2 rad", *(f"{x:.4f}" for x in columns[:, k]))
        for k, label in enumerate(LABELS)
    ]
    header = ("error", "unit", "true", "published", "search", "least squares")
    return Table(
        header, tuple(rows), f"Recovered errors; search: {USED}, median of {len(runs)}"
    )


def cost_table(
    runs: Runs, solution: KinematicSolution, seconds: float, test: Measurements
) -> Table:
    """Pose error on poses left out, and what it cost."""

    def row(name: str, x: Any, evaluations: int, time: Any) -> tuple[str, ...]:
        place, turn = (e.mean(axis=1) for e in pose_errors(np.atleast_2d(x), test))
        worst = np.abs(np.atleast_2d(x) - TRUE).max(axis=1)
        cells = [_spread(1e3 * place), _spread(1e3 * turn), _spread(1e3 * worst)]
        return (name, *cells, f"{evaluations:,}", _spread(np.atleast_1d(time)))

    genetic = [run["genetic"] for run in runs]
    rows = [row("nominal", 0 * TRUE, 0, 0.0), row("genetic", genetic, 12000, np.nan)]
    for name in [key for key in runs[0] if key.startswith("tabu")]:
        tabu, times = ([run[name][key] for run in runs] for key in ("x", "seconds"))
        count = runs[0][name]["evaluations"]
        rows.append(row(f"genetic + {name}", tabu, count, times))
    rows.append(row("least squares", solution.x, solution.evaluations, seconds))
    header = ("", "place [mm]", "orientation [mrad]", "worst error [mm, mrad]")
    caption = "Mean pose error on 20 poses left out: median (worst) of the runs"
    return Table((*header, "evaluations", "time [CPU s]"), tuple(rows), caption)


def bounds_table(bounds: Mapping[float, Mapping[str, float]]) -> Table:
    """Errors with noise, against the least that is possible."""
    rows = [
        (f"{x:.0%}", f"{b['pooled']:.3f}", f"{b['worst']:.3f}", f"{b['coverage']:.1%}")
        for x, b in bounds.items()
    ]
    header = ("outliers", "all errors", "worst of 24", "inside 95 % interval")
    caption = "Least squares, 0.05 mm and mrad noise, 100 seeds: RMS over Cramér-Rao"
    return Table(header, tuple(rows), caption)


def _spread(x: Any) -> str:
    if np.isnan(x).any():
        return "–"
    return f"{np.median(x):.3g}" + (f" ({np.max(x):.3g})" if len(x) > 1 else "")
