"""Tables and figure of ``real_arms.py``; it prints nothing by itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from real_arms_data import Score

from hybrid.arrays import Array
from hybrid.report import Table
from hybrid.report.style import BLACK, BLUE, GREY, clean, new_figure


def arm_table(scores: Sequence[Score]) -> Table:
    """Errors on every split of one arm, beside plain least squares."""
    decimals = 1 if scores[0].plain.rms.mean() > 50 else 2
    rows = []
    for score in scores:
        rows.append(
            _row(f"plain LS, {score.held_out}", score.plain.rms, ("", ""), decimals)
        )
        for row in score.validation.rows:
            if row.name.startswith("published"):
                against = _against(row.rms, score.plain.rms)
                rows.append(_row(row.name, row.rms, against, decimals))
        last = score.validation.rows[-1].rms
        worst = int(score.ratio.argmax())
        change, error = score.ratio[worst] - 1, score.ratio_error[worst]
        against = (
            _against(last, score.plain.rms)[0],
            f"{100 * change:+.1f} ± {100 * error:.1f} %",
        )
        rows.append(_row(f"ours, {score.held_out}", last, against, decimals))
    numbers = tuple(f"{k + 1}" for k in range(len(scores[0].plain.rms)))
    header = ("joint", *numbers, "mean", "vs plain LS", "worst joint")
    return Table(
        header, tuple(rows), f"{scores[0].arm.name}: held-out RMS torque error, N·m"
    )


def ratio_figure(scores: Sequence[Score]) -> Figure:
    """Error of our ladder over that of plain least squares, joint by joint."""
    arms = list(dict.fromkeys(score.arm.name for score in scores))
    figure = new_figure(height=2.6)
    for axes, arm in zip(figure.subplots(1, len(arms), sharey=True), arms, strict=True):
        ratio = np.array([score.ratio for score in scores if score.arm.name == arm])
        x = np.arange(1, ratio.shape[1] + 1)
        clean(axes, grid="y")
        axes.bar(x, np.median(ratio, axis=0), 0.7, color=BLUE, alpha=0.35)
        axes.plot(x, ratio.T, "o", color=BLUE, markersize=4)
        axes.axhline(1.0, color=BLACK, linewidth=0.8)
        axes.set_title(arm, loc="left", fontsize=9, fontweight="bold", color=GREY)
        axes.set_xlabel("joint")
        axes.set_xticks(x)
    figure.axes[0].set_ylabel("RMS error, ours / plain LS")
    return figure


def _against(rms: Array, plain: Array) -> tuple[str, ...]:
    """Change of the mean, and of the worst joint."""
    changes = rms.mean() / plain.mean(), (rms / plain).max()
    return tuple(f"{100 * (x - 1):+.1f} %" for x in changes)


def _row(
    name: str, rms: Array, against: tuple[str, ...], decimals: int
) -> tuple[str, ...]:
    numbers = [f"{x:.{decimals}f}" for x in (*rms, rms.mean())]
    return (name, *numbers, *(x.replace("-", "−") for x in against))
