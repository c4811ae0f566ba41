"""Figures of a designed motion: how it moves, and what it reveals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hybrid.names import figure_text
from hybrid.report.style import (
    BLUE,
    GREY,
    OTHERS,
    RED,
    clean,
    finish,
    legend,
    new_figure,
    panels,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid.excitation import Design, Limits
    from hybrid.plant.reference import Reference


def motion_figure(
    reference: Reference, joints: Sequence[str], limits: Limits | None = None
) -> Figure:
    """Position, and below it speed, of every joint, with its limits.

    Args:
        reference: Motion of n joints.
        joints: Joint names, length n.
        limits: Limits to draw.

    Returns:
        Figure of 2n axes.
    """
    figure, cells = panels(len(joints), height=2.1, ratios=(1.4, 1.0))
    for j, (above, below) in enumerate(cells):
        above.plot(reference.t, reference.q[:, j], color=BLUE, linewidth=1.2)
        below.plot(reference.t, reference.v[:, j], color=OTHERS[0], linewidth=1.0)
        for axes in (above, below):
            clean(axes, grid="y")
            axes.margins(x=0)
        if limits is not None:
            bounds = (limits.low[j], limits.high[j]), limits.speed[j]
            for axes, pair in ((above, bounds[0]), (below, (-bounds[1], bounds[1]))):
                for level in pair:
                    axes.axhline(level, color=RED, linewidth=0.8, linestyle=":")
        above.set_title(
            figure_text(joints[j]), loc="left", fontsize=9, fontweight="bold"
        )
        above.set_ylabel("position\n[rad]")
        below.set_ylabel("speed\n[rad/s]")
    finish(figure, [below for _, below in cells], "time [s]")
    return figure


def information_figure(design: Design) -> Figure:
    """Singular values of the observation matrix, and predicted standard errors.

    Args:
        design: Designed motions.

    Returns:
        Figure of two axes.
    """
    figure = new_figure(height=5.2)
    above, below = figure.subplots(2, 1, height_ratios=(1.0, 1.3))
    order = np.arange(1, design.observation.size + 1)
    sums = np.cumsum(design.grams, axis=0)
    handles = []
    for k, gram in enumerate(sums):
        values = np.sqrt(np.maximum(np.linalg.eigvalsh(gram)[::-1], 0.0))
        last = k == len(sums) - 1
        line = above.plot(
            order, values, ".-", color=BLUE if last else GREY, markersize=4,
            linewidth=0.9, alpha=1.0 if last else 0.3 + 0.5 * k / len(sums),
            label=f"{k + 1} motion{'s' if k else ''}",
        )  # fmt: skip
        handles += line
    above.set_yscale("log")
    above.set_ylabel("singular value")
    above.set_xlabel(f"of {design.observation.size}, largest first")
    labels = [_short(x) for x in design.observation.base.kept_labels]
    errors = design.standard_errors() / design.observation.scale
    below.plot(order, errors, "o", color=BLUE, markersize=4)
    below.set_yscale("log")
    below.set_ylabel("predicted standard error\n[SI units]")
    small = 8 if len(labels) < 30 else 5
    below.set_xticks(order, [*map(figure_text, labels)], rotation=90)
    for axes in (above, below):
        clean(axes, grid="y")
        axes.tick_params(which="both", labelsize=8)
    below.tick_params(axis="x", labelsize=small)
    legend(figure, handles[:8])
    return figure


def _short(label: str) -> str:
    """``viscous.coefficient[elbow]`` as ``viscous, elbow``; others as they are."""
    effect, _, rest = label.partition(".")
    joint = rest.partition("[")[2].rstrip("]")
    return f"{effect}, {joint}" if joint else label
