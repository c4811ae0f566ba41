"""Which effect was named for which: a table as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from hybrid.report.style import BLACK, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LAST = "nothing"


def confusion_figure(counts: Mapping[tuple[str, str], int]) -> Figure:
    """How often each true effect was named what; what is right lies on the diagonal.

    Args:
        counts: Number of cases by true and named effect; ``nothing`` on either side.

    Returns:
        Figure of one axes; shade is the share of a true effect's cases.
    """
    names = sorted({n for pair in counts for n in pair} - {_LAST}) + [_LAST]
    place = {name: k for k, name in enumerate(names)}
    table = np.zeros((len(names), len(names)))
    for (true, named), count in counts.items():
        table[place[true], place[named]] = count
    figure = new_figure(height=1.6 + 0.2 * len(names))
    axes = figure.subplots()
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    axes.imshow(share, cmap="Blues", vmin=0, vmax=1.4, aspect="auto")
    for i, j in np.argwhere(table > 0):
        axes.text(
            j,
            i,
            f"{table[i, j]:.0f}",
            ha="center",
            va="center",
            fontsize=7,
            color=BLACK,
        )
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("named first", fontsize=8)
    axes.set_ylabel("true effect, alone, ≥ 1×", fontsize=8)
    return figure
