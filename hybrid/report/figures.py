"""Measured and predicted torque over time.

A figure is one of its own and leaves matplotlib's global state alone. Colours are told
apart by colour-blind readers, and by their lightness in print.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.names import figure_text
from hybrid.report.style import (
    BEST,
    OTHERS,
    PALE,
    check_shape,
    clean,
    finish,
    legend,
    panels,
)
from hybrid.signals import Motion, Sampler, motion_from_recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid.identification import DynamicModel
    from hybrid.recording import Recording

_EXCERPT_SECONDS = 3.0  # of a recording: more is not to be made out


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
            below.plot(t, measured[:, j] - torque[:, j], color=ink, linewidth=0.7)
        for axes in (above, below):
            clean(axes, grid="y")
            axes.margins(x=0)
        name = figure_text(joints[j])
        above.set_title(name, loc="left", fontsize=9, fontweight="bold")
        above.set_ylabel("torque\n[N·m]")
        below.set_ylabel("residual\n[N·m]")
    finish(figure, [below for _, below in cells], "time [s]")
    legend(figure, cells[0][0].get_legend_handles_labels()[0])
    return figure


def excerpt_figure(model: DynamicModel, recording: Recording) -> Figure:
    """Torque in the middle of a recording, and what models predict of it.

    Args:
        model: The model, with its plain version among the simpler ones.
        recording: A log of the arm.
    """
    motion, sampler = seen_by(model, recording)
    half = round(_EXCERPT_SECONDS * motion.rate / 2)
    middle = len(motion.t) // 2
    part = slice(max(0, middle - half), middle + half)
    torques = {"measured": motion.tau, "all stages": model.predict(motion)}
    if "LS" in model.simpler:
        plain = model.simpler["LS"].predict(motion)
        torques = {"measured": motion.tau, "plain least squares": plain} | torques
    shown = {name: sampler(tau)[part] for name, tau in torques.items()}
    measured = shown.pop("measured")
    return torque_figure(motion.t[part], measured, shown, model.robot.joints)


def seen_by(model: DynamicModel, recording: Recording) -> tuple[Motion, Sampler]:
    """Motion as the identification sees it, and its filter without decimation."""
    motion = motion_from_recording(recording, cutoff=2 * model.cutoff)
    return motion, Sampler(motion.rate, model.cutoff, 1)
