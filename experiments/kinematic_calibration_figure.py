"""Figure of ``kinematic_calibration.py``: the way down of each solver."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from mh6 import pose_errors

from hybrid.calibration import Measurements
from hybrid.calibration.solve import KinematicSolution
from hybrid.report.style import BLUE, GREY, RED, clean, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def way_down(
    runs: Sequence[Mapping[str, Any]], solution: KinematicSolution, test: Measurements
) -> Figure:
    """Error against evaluations, one line a run."""
    figure = new_figure(height=3.0)
    axes = figure.subplots()
    clean(axes, grid="both")
    for run in runs:
        steps = np.diff(np.append(0, 40 * np.arange(1, 301)))
        cost = np.cumsum(np.concatenate([steps, [1], np.full(2500, 20)]))
        for name, style in (("tabu 3%", "-"), ("tabu 10%", ":")):
            label = name if run is runs[0] else None
            history = 1e3 * run[name]["history"]
            axes.loglog(cost, history, style, color=GREY, linewidth=0.9, label=label)
    axes.axvline(12000, color=RED, linewidth=0.8, linestyle=":")
    axes.text(12500, 5, "tabu", color=RED, fontsize=8)
    ours = sum(e.mean() for e in pose_errors(solution.x[None], test))
    axes.loglog(solution.evaluations, 1e3 * max(ours, 1e-16), "o", color=BLUE)
    axes.text(1.2 * solution.evaluations, 1e3 * ours, "least squares", fontsize=8)
    axes.set_xlabel("evaluations of 50 poses")
    axes.set_ylabel("mean place + 1 m · orientation error [mm]")
    axes.legend(frameon=False, fontsize=8, loc="lower right", title="first radius")
    return figure
