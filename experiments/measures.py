"""Several measures of the same methods over many runs: medians, spread, and ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from hybrid.arrays import Array
from hybrid.report.style import BLUE, GREY, clean, new_figure
from hybrid.report.table import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def measures_table(
    methods: Sequence[str],
    values: Mapping[str, Array],
    units: Mapping[str, str],
    *,
    first: int = 0,
) -> Table:
    """Median and range of every measure, and its median ratio to one method's.

    Args:
        methods: Names of the K methods.
        values: Values of each measure, shape (S, K), in runs that differ in their seed.
        units: Unit of each measure.
        first: The method that the others are compared with.
    """
    header = [""]
    for name in values:
        header += [f"{name} [{units[name]}]", "lowest–highest", f"÷ {methods[first]}"]
    rows = []
    for k, method in enumerate(methods):
        row = [method]
        for x in values.values():
            ratio = np.median(x[:, k] / x[:, first])
            row += [f"{np.median(x[:, k]):.3g}"]
            row += [f"{x[:, k].min():.3g}–{x[:, k].max():.3g}", f"{ratio:.2f}"]
        rows.append(tuple(row))
    count = len(next(iter(values.values())))
    return Table(tuple(header), tuple(rows), f"Medians over {count} seeds")


def measures_figure(
    methods: Sequence[str], values: Mapping[str, Array], units: Mapping[str, str]
) -> Figure:
    """One panel a measure: every run as a line over the methods, and the median.

    Args:
        methods: Names of the K methods.
        values: Values of each measure, shape (S, K).
        units: Unit of each measure.
    """
    figure = new_figure(height=2.9)
    x = np.arange(len(methods))
    panels = figure.subplots(1, len(values), squeeze=False)[0]
    for axes, (name, y) in zip(panels, values.items(), strict=True):
        clean(axes, grid="y")
        axes.plot(x, y.T, color=GREY, linewidth=0.6, alpha=0.6)
        axes.plot(x, np.median(y, axis=0), "o-", color=BLUE)
        axes.set_ylim(0, 1.05 * y.max())
        axes.set_title(f"{name} [{units[name]}]", fontsize=9)
        axes.set_xticks(
            x, [method.replace(" ", "\n") for method in methods], fontsize=7
        )
    return figure
