"""The report of one identification: a page, its figures, and the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.viscous import Viscous
from hybrid.report.figures import friction_figure, rms_figure, torque_figure
from hybrid.report.fit import content_from_fit, effects_table
from hybrid.report.output import save_figure, write_results
from hybrid.report.page import Section, write_page
from hybrid.report.table import table_from_validation
from hybrid.signals import Motion, Sampler, motion_from_recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hybrid.identify import DynamicModel, Fit, Validation
    from hybrid.recording import Recording


_LAWS = (Coulomb, Viscous, ThresholdFriction)  # of speed alone, to be drawn over it
_EXCERPT_SECONDS = 3.0  # of a recording: more is not to be made out
_POINTS = 8000


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
    first, last = validation.rows[0], validation.rows[-1]
    text = (
        f"Mean RMS torque error on motions that no fit has seen: {last.mean:.3g} N·m "
        f"instead of {first.mean:.3g} by plain least squares, "
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


def excerpt_figure(model: DynamicModel, recording: Recording) -> Figure:
    """Torque in the middle of a recording, and what models predict of it.

    Args:
        model: The model, with its plain version among the simpler ones.
        recording: A log of the arm.
    """
    motion, sampler = _prepared(model, recording)
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


def laws_figure(model: DynamicModel, recordings: Sequence[Recording]) -> Figure:
    """Friction over speed: what all other terms leave, and the law that was fitted.

    Args:
        model: The model.
        recordings: Logs of the arm.
    """
    speeds, rest = [], []
    for recording in recordings:
        motion, sampler = _prepared(model, recording)
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


def _prepared(model: DynamicModel, recording: Recording) -> tuple[Motion, Sampler]:
    """Motion as the identification sees it, and its filter without decimation."""
    motion = motion_from_recording(recording, cutoff=2 * model.cutoff)
    return motion, Sampler(motion.rate, model.cutoff, 1)


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
