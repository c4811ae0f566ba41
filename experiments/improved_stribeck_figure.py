"""Figure of ``improved_stribeck.py``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hybrid.report.style import BLACK, BLUE, GREY, RED, clean, legend, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK = {"genetic": GREY, "annealed": RED}


def way_down(joints: Sequence[dict[str, Any]]) -> Figure:
    """Squares over those of least squares, by generation."""
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
    return figure
