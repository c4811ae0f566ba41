"""Figures of an identification: errors, torques and friction laws.

Each function returns a figure of its own and leaves matplotlib's global state alone.
Colours are told apart by colour-blind readers, and by their lightness in print.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.names import figure_text
from hybrid.report.style import (
    BEST,
    BLUE,
    GREY,
    OTHERS,
    PALE,
    RED,
    check_shape,
    clean,
    finish,
    legend,
    new_figure,
    panels,
    stage_inks,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid.identify import Validation


# More points than this hide each other.
MOST_POINTS = 3000


def rms_figure(validation: Validation) -> Figure:
    """Torque error of every stage, per joint and mean: in N·m above, in % below.

    Args:
        validation: Errors of every stage on motions that no fit has seen.

    Returns:
        Figure of two axes.
    """
    figure = new_figure(height=4.6)
    above, below = figure.subplots(2, 1, sharex=True)
    rms = np.array([np.append(row.rms, row.mean) for row in validation.rows])
    inks = stage_inks([row.name for row in validation.rows])
    share = np.array([row.relative for row in validation.rows])
    share = 100 * np.column_stack([share, share.mean(axis=1)])  # (stages, n + 1)
    # The last group, the mean, stands apart from the joints.
    x = np.append(np.arange(len(validation.joints)), len(validation.joints) + 0.4)
    width = 0.84 / len(rms)
    for axes, values in ((above, rms), (below, share)):
        clean(axes, grid="y")
        bars = []
        for k, (row, height) in enumerate(zip(validation.rows, values, strict=True)):
            ink = inks[row.name]
            left = x - 0.42 + k * width
            bars.append(
                axes.bar(
                    left, height, 0.92 * width, align="edge", color=ink, label=row.name
                )
            )
    handles: list[Any] = bars
    if validation.noise_floor is not None:
        floor = np.append(validation.noise_floor, validation.noise_floor.mean())
        ends = np.stack([x - 0.45, x + 0.43])
        lines = above.plot(ends, np.stack([floor, floor]), color=RED, linewidth=1.4)
        lines[0].set_label("noise floor")
        handles.append(lines[0])
    above.margins(x=0.01)
    above.set_ylabel("RMS error [N·m]")
    below.set_ylabel("relative error [%]")
    below.set_xticks(x, [*map(figure_text, validation.joints), "mean"])
    legend(figure, handles)
    return figure


def torque_figure(
    t: Array, measured: Array, predicted: Mapping[str, Array], joints: Sequence[str]
) -> Figure:
    """Measured and predicted torque, and below each joint what is left.

    Args:
        t: Time, shape (N,), in [s].
        measured: Joint torque, shape (N, n), in [N·m].
        predicted: Predictions by name, each of shape (N, n), in [N·m]; at most three.
        joints: Joint names, n of them.

    Returns:
        Figure of 2n axes: torque and residual of each joint.

    Raises:
        HybridError: A shape does not fit, or there are more than three predictions.
    """
    most = len(OTHERS) + 1
    if not 1 <= len(predicted) <= most:
        raise HybridError(f"{len(predicted)} predictions, valid are 1 to {most}")
    shape = (len(t), len(joints))
    for name, torque in {"measured": measured, **predicted}.items():
        check_shape(name, torque, shape)
    inks = (*OTHERS[: len(predicted) - 1], BEST)
    figure, cells = panels(len(joints), height=2.1, ratios=(2.2, 1.0))
    for j, (above, below) in enumerate(cells):
        above.plot(t, measured[:, j], color=PALE, linewidth=2.2, label="measured")
        for (name, torque), ink in zip(predicted.items(), inks, strict=True):
            above.plot(t, torque[:, j], color=ink, linewidth=0.9, label=name)
            left = measured[:, j] - torque[:, j]
            below.plot(t, left, color=ink, linewidth=0.7)
        for axes in (above, below):
            clean(axes, grid="y")
            axes.margins(x=0)
        above.set_title(
            figure_text(joints[j]), loc="left", fontsize=9, fontweight="bold"
        )
        above.set_ylabel("torque\n[N·m]")
        below.set_ylabel("residual\n[N·m]")
    finish(figure, [below for _, below in cells], "time [s]")
    legend(figure, cells[0][0].get_legend_handles_labels()[0])
    return figure


def friction_figure(
    v: Array,
    residual: Array,
    curves: Sequence[tuple[Array, Array]],
    joints: Sequence[str],
) -> Figure:
    """Torque that other terms leave, against speed, and the law fitted to it.

    Args:
        v: Joint speed, shape (N, n), in [rad/s].
        residual: Measured torque less all terms but the law, shape (N, n), in [N·m].
        curves: Per joint the fitted law: speed, shape (m,), in [rad/s], and torque,
            shape (m,), in [N·m]. NaN breaks the line.
        joints: Joint names, n of them.

    Returns:
        Figure of n axes.

    Raises:
        HybridError: A shape does not fit.
    """
    check_shape("residual", residual, v.shape)
    if not v.shape[1] == len(curves) == len(joints):
        raise HybridError(
            f"speeds of {v.shape[1]} joints, {len(curves)} curves and "
            f"{len(joints)} joint names: one of each per joint is needed"
        )
    figure, cells = panels(len(joints), height=1.9)
    step = -(-len(v) // MOST_POINTS)
    for j, ((axes,), (speed, torque)) in enumerate(zip(cells, curves, strict=True)):
        clean(axes, grid="both")
        axes.plot(
            v[::step, j], residual[::step, j], ".", color=GREY, markersize=2.5,
            alpha=0.5, markeredgewidth=0, rasterized=True,
            label="measured − other terms",
        )  # fmt: skip
        axes.plot(speed, torque, color=BLUE, linewidth=1.6, label="fitted law")
        axes.set_title(
            figure_text(joints[j]), loc="left", fontsize=9, fontweight="bold"
        )
        axes.set_ylabel("torque [N·m]")
    finish(figure, [axes for (axes,) in cells], "speed [rad/s]")
    legend(figure, cells[0][0].get_legend_handles_labels()[0])
    return figure
