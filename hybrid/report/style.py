"""The style of all figures: colours, sizes, panels and legends."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.names import figure_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    Axes = Figure = Any  # matplotlib is slow to load

Curve = tuple[str, Array, str, float]  # name, values (N, n), colour, width in points

BLACK = "#1a1a1a"
GREY = "#8c8c8c"
PALE = "#bdbdbd"
BLUE = "#0072b2"
RED = "#d55e00"

# Greys for the rigid body with plain friction, then blues, darker with each stage.
STAGES = {
    "LS": "#d9d9d9",
    "WLS": "#b8b8b8",
    "IRLS": "#8c8c8c",
    "+ friction": "#9ecae1",
    "+ ripple": "#4a97c9",
    "+ remainder": "#08519c",
}
_OTHER_MODELS = ("#cbc9e2", "#9e9ac8", "#6a51a3", "#3f007d")
# Predictions on top of a broad grey line: the last one, the best, is dark blue.
BEST = "#08519c"
OTHERS = ("#e69f00", "#56b4e9")

WIDTH = 7.2  # inches: the text width of a page
_NAMES_A_LINE = 7  # of a legend, at most
_MOST_POINTS = 3000  # of a line
_GRID = "#e3e3e3"


def stage_inks(names: Sequence[str]) -> dict[str, str]:
    """A colour for each model by name; the last model is the best."""
    others = [name for name in names[:-1] if name not in STAGES]
    inks = dict(zip(others, cycle(_OTHER_MODELS), strict=False))
    return STAGES | inks | {names[-1]: BEST}


def new_figure(height: float) -> Figure:
    """An empty figure of the page's width and a height in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, height), layout="constrained")


def panels(
    titles: Sequence[str],
    height: float,
    ratios: tuple[float, ...] = (1.0,),
    *,
    label: str = "time [s]",
    size: float = 9,
) -> tuple[Figure, list[list[Axes]]]:
    """A figure of panels in two columns, usually one per joint, and the axes of each.

    Args:
        titles: Title of each panel.
        height: Height of one panel, in [inch].
        ratios: Heights of the axes in a panel, from top to bottom.
        label: Label of the horizontal axis, below each column.
        size: Size of the titles, in [point].
    """
    columns = min(2, len(titles))
    rows = -(-len(titles) // columns)
    figure = new_figure(0.3 + height * rows)
    # One grid for all axes, so that their left edges are in line.
    ratio = ratios * rows
    grid = figure.add_gridspec(len(ratio), columns, height_ratios=ratio)
    cells: list[list[Axes]] = []
    for k, title in enumerate(titles):
        row, column = len(ratios) * (k // columns), k % columns
        cells.append([])
        for i in range(len(ratios)):
            shared = cells[k][0] if i else None
            axes = figure.add_subplot(grid[row + i, column], sharex=shared)
            axes.tick_params(labelbottom=i == len(ratios) - 1)
            clean(axes, grid="y")
            axes.margins(x=0)
            cells[k].append(axes)
        name = figure_text(title)
        cells[k][0].set_title(name, loc="left", fontsize=size, fontweight="bold")
    for panel in cells[-2:]:
        panel[-1].set_xlabel(label)
    figure.align_ylabels()
    return figure, cells


def lines_figure(
    t: Array,
    joints: Sequence[str],
    rows: Mapping[str, Sequence[Curve]],
    height: float,
    ratios: tuple[float, ...] = (),
) -> tuple[Figure, list[list[Axes]]]:
    """Draw curves of every joint over time, with a legend of those that have a name.

    ``rows`` are curves by the label of their axes, from top to bottom; without ratios
    all are as high. See :func:`panels`.
    """
    figure, cells = panels(joints, height, ratios or (1.0,) * len(rows))
    for j, cell in enumerate(cells):
        for axes, (label, curves) in zip(cell, rows.items(), strict=True):
            for name, x, ink, width in curves:
                k = extremes([x[:, j]], _MOST_POINTS)
                axes.plot(t[k], x[k, j], color=ink, linewidth=width, label=name)
            axes.set_ylabel(label)
    named = [x for axes in cells[0] for x in axes.get_legend_handles_labels()[0]]
    if named:
        legend(figure, named)
    return figure, cells


def extremes(curves: Sequence[Array], most: int) -> Index:
    """The ends of curves, and the lowest and highest point of each in every interval.

    Where there are at most ``most`` samples, these are all.
    """
    size = len(curves[0])
    if size <= most:
        return np.arange(size)
    edges = np.linspace(0, size, most // 2).astype(int)
    ends = [*zip(edges[:-1], edges[1:], strict=True)]
    pairs = [
        (a + y[a:b].argmin(), a + y[a:b].argmax()) for a, b in ends for y in curves
    ]
    return np.unique([(0, size - 1), *pairs])


def clean(axes: Axes, grid: Literal["x", "y", "both"]) -> None:
    """Remove the box and the ticks, and draw a faint grid behind the data."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(labelsize=8, length=0, colors=BLACK)
    axes.grid(axis=grid, color=_GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)


def legend(figure: Figure, handles: Sequence[Any], *, enlarge: float = 3.0) -> None:
    """Draw a legend above all axes."""
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=-(-len(handles) // -(-len(handles) // _NAMES_A_LINE)),
        frameon=False,
        fontsize=8,
        markerscale=enlarge,
        handlelength=1.4,
        columnspacing=1.4,
        borderaxespad=0.2,
    )
