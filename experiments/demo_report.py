"""The report of the demo: a page, its figures, and the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.viscous import Viscous
from hybrid.names import figure_text
from hybrid.report import (
    Section,
    save_figure,
    table_from_validation,
    write_page,
    write_results,
)
from hybrid.report.fit import content_from_fit, effects_table, excerpt_figure, seen_by
from hybrid.report.style import (
    BLUE,
    GREY,
    RED,
    clean,
    legend,
    new_figure,
    panels,
    stage_inks,
)
from hybrid.signals import Motion

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid.identification import DynamicModel, Fit, Validation
    from hybrid.recording import Recording


_LAWS = (Coulomb, Viscous, ThresholdFriction)  # of speed alone, to be drawn over it
_POINTS = 8000
MOST_POINTS = 3000  # more than this hide each other


def write_identification(
    folder: str | Path,
    fit: Fit,
    validation: Validation,
    recordings: Sequence[Recording],
    *,
    provenance: Mapping[str, Any],
) -> str:
    """Write ``index.html``, ``results.json``, the model, and PNG figures.

    Args:
        folder: Where to.
        fit: The identification.
        validation: Its errors on recordings that it has not seen.
        recordings: Those recordings.
        provenance: With what it was made; see :func:`hybrid.report.provenance`.

    Returns:
        The result in a sentence.
    """
    folder, model = Path(folder), fit.model
    figures = {
        "errors": rms_figure(validation),
        "torque": excerpt_figure(model, recordings[0]),
        "friction": laws_figure(model, recordings),
    }
    for name, figure in figures.items():
        save_figure(figure, folder / f"{name}.png")
    lead, command = _summary(validation), str(provenance.get("command", ""))
    write_page(
        folder / "index.html",
        f"{model.robot.name}: from logs to a model",
        _sections(fit, validation, figures, command),
        lead=lead,
        provenance=provenance,
    )
    content = {"validation": validation.as_dict(), "fit": content_from_fit(fit)}
    write_results(folder / "results.json", {"provenance": provenance, **content})
    model.save(folder / "model.json")
    return lead


def _summary(validation: Validation) -> str:
    plain, last = validation.reference, validation.rows[-1]
    text = (
        f"Mean RMS torque error on motions that no fit has seen: {last.mean:.3g} N·m "
        f"instead of {plain.mean:.3g} by the best linear fit, "
        f"{validation.reduction:.0%} less"
    )
    if validation.noise_floor is not None:
        above = last.mean / float(validation.noise_floor.mean())
        text += f"; {above:.2f} times the noise floor"
    return f"{text}."


def _sections(
    fit: Fit, validation: Validation, figures: Mapping[str, Figure], command: str
) -> list[Section]:
    left_out = [f"Left out, as it does not help: {text}." for text in fit.left_out]
    return [
        Section(
            "Error, stage by stage",
            "\n\n".join(["Joints are scored while they move.", *left_out]),
            table_from_validation(validation),
            figures["errors"],
            "RMS torque error of each joint, in N·m and relative to its torque.",
        ),
        Section(
            "Measured and predicted torque",
            figure=figures["torque"],
            caption="The middle of a motion that no fit has seen, and what is left.",
        ),
        Section(
            "Friction over speed",
            figure=figures["friction"],
            caption="What all other terms leave, on motions that no fit has seen.",
        ),
        Section("What was found", table=effects_table(fit)),
        Section(
            "What these recordings do not tell",
            "; ".join(fit.unidentifiable or ("everything is known",)) + ".",
            command=command,
        ),
    ]


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


def laws_figure(model: DynamicModel, recordings: Sequence[Recording]) -> Figure:
    """Friction over speed: what all other terms leave, and the law that was fitted.

    Args:
        model: The model.
        recordings: Logs of the arm.
    """
    speeds, rest = [], []
    for recording in recordings:
        motion, sampler = seen_by(model, recording)
        others = model.predict(motion) - _friction(model, motion)
        speeds.append(motion.v[motion.mask])
        rest.append(sampler(motion.tau - others)[motion.mask])
    v, left = np.concatenate(speeds), np.concatenate(rest)
    step = -(-len(v) // _POINTS)
    # Two branches, so that no line joins them through the jump at rest.
    branch = np.linspace(1e-3, 1.0, 200)
    share = np.concatenate([-branch[::-1], [np.nan], branch])
    speed = share[:, None] * np.abs(v).max(axis=0)
    law = _friction(model, _moving_at(speed, model.robot.joints))
    curves = [(speed[:, j], law[:, j]) for j in range(model.robot.size)]
    return friction_figure(v[::step], left[::step], curves, model.robot.joints)


def _friction(model: DynamicModel, motion: Motion) -> Array:
    """Torque of the laws that depend on speed alone, shape (N, n), [N·m]."""
    tau, body = np.zeros_like(motion.v), model.body(motion)
    for effect in model.effects:
        if isinstance(effect, _LAWS):
            tau[:, effect.joints] += effect.torque(motion, body)
    return tau


def _moving_at(speed: Array, joints: tuple[str, ...]) -> Motion:
    """A motion of these speeds, shape (N, n), [rad/s], and nothing else."""
    t, zero = np.arange(len(speed)) / 100.0, np.zeros_like(speed)
    everywhere = np.ones(len(t), dtype=bool)
    return Motion(t, zero, speed, zero, zero, everywhere, joints=joints)


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
    """
    figure, cells = panels(joints, height=1.9, label="speed [rad/s]")
    step = -(-len(v) // MOST_POINTS)
    for j, ((axes,), (speed, torque)) in enumerate(zip(cells, curves, strict=True)):
        clean(axes, grid="both")
        axes.margins(x=0.05)
        axes.plot(
            v[::step, j], residual[::step, j], ".", color=GREY, markersize=2.5,
            alpha=0.5, markeredgewidth=0, rasterized=True,
            label="measured − other terms",
        )  # fmt: skip
        axes.plot(speed, torque, color=BLUE, linewidth=1.6, label="fitted law")
        axes.set_ylabel("torque [N·m]")
    legend(figure, cells[0][0].get_legend_handles_labels()[0])
    return figure
