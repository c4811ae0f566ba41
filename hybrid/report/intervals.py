"""Figure of what the data say about each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hybrid.arrays import Array
from hybrid.names import figure_text
from hybrid.report.style import BLACK, BLUE, RED, check_shape, clean, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Half-width of a 95 % interval, in standard deviations.
INTERVAL = 1.96
# An estimate of zero has no relative width; it is drawn here.
WIDEST = 1e4  # %


def parameter_figure(
    names: Sequence[str],
    estimate: Array,
    std: Array,
    truth: Array | None = None,
) -> Figure:
    """How well every parameter is known.

    With the truth: error in standard deviations, against the 95 % interval. Without:
    half-width of the 95 % interval in percent of the estimate, where 100 % is a
    parameter that cannot be told from zero. A parameter without a finite standard
    deviation has a name and no mark.

    Args:
        names: Parameter names, p of them.
        estimate: Estimates, shape (p,), in any units.
        std: Their standard deviations, shape (p,), in the same units.
        truth: True values where they are known, shape (p,), in the same units.

    Returns:
        Figure of one axes.

    Raises:
        HybridError: A shape does not fit.
    """
    given = {"estimate": estimate, "std": std}
    for name, values in (given if truth is None else {**given, "truth": truth}).items():
        check_shape(name, values, (len(names),))
    figure = new_figure(height=0.8 + 0.19 * len(names))
    axes = figure.subplots()
    clean(axes, grid="x")
    with np.errstate(divide="ignore", invalid="ignore"):
        if truth is None:
            width = 100 * INTERVAL * std / np.abs(estimate)
            _draw_widths(axes, np.minimum(width, WIDEST))
        else:
            _draw_errors(axes, np.where(std > 0, (estimate - truth) / std, np.nan))
    axes.set_yticks(np.arange(len(names)), [*map(figure_text, names)])
    axes.set_ylim(len(names) - 0.4, -0.6)  # the first one on top
    return figure


def _draw_errors(axes: Axes, error: Array) -> None:
    y = np.arange(len(error))
    inside = np.abs(error) <= INTERVAL
    outside = np.abs(error) > INTERVAL
    axes.axvspan(-INTERVAL, INTERVAL, color=BLUE, alpha=0.12, linewidth=0)
    axes.axvline(0, color=BLACK, linewidth=0.8)
    axes.hlines(y, 0, error, color=np.where(inside, BLUE, RED), linewidth=1)
    axes.plot(error[inside], y[inside], "o", color=BLUE, markersize=4)
    # Another shape too, for readers who do not see the colour.
    axes.plot(error[outside], y[outside], "D", color=RED, markersize=4)
    reach = 1.1 * float(np.nanmax(np.abs(error), initial=3.0))
    axes.set_xlim(-reach, reach)
    axes.set_xlabel(
        "(estimate − truth) / standard deviation;  shaded: 95 % interval, "
        f"holds {inside.sum()} of {np.isfinite(error).sum()}"
    )


def _draw_widths(axes: Axes, percent: Array) -> None:
    y = np.arange(len(percent))
    known, unknown = percent < 100, percent >= 100
    axes.set_xscale("log")
    axes.axvline(100, color=BLACK, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.plot(percent[known], y[known], "o", color=BLUE, markersize=4)
    axes.plot(percent[unknown], y[unknown], "D", color=RED, markersize=4)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel(
        "half-width of the 95 % interval [% of the estimate];  "
        "beyond 100 %: not told from zero"
    )
