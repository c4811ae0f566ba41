"""Show results as tables, columns of numbers, pictures and pages.

:class:`hybrid.shown.Shown` calls what is public here.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hybrid import report
from hybrid.calibration import Calibration
from hybrid.diagnosis.answer.diagnosis import Diagnosis
from hybrid.diagnosis.answer.words import probability
from hybrid.excitation import Design
from hybrid.identification import Fit
from hybrid.identification.validation import Validation
from hybrid.inspect import Inspection
from hybrid.inspect.coverage import JointCoverage
from hybrid.names import figure_text
from hybrid.report.calibration import corrections_table
from hybrid.report.fit import held_out_table
from hybrid.report.inspection import joints_table, write_inspection
from hybrid.report.output import Section, provenance, render_page
from hybrid.report.servo import gap_table
from hybrid.report.style import (
    BEST,
    BLUE,
    GREY,
    PALE,
    Axes,
    clean,
    new_figure,
    stage_inks,
)
from hybrid.report.table import Table
from hybrid.servo import ServoFit
from hybrid.shown import counted

_HEIGHT = 3.2  # inches


def text(result: Any) -> str:
    """The table of a result as lines of text."""
    shown = _VIEWS[type(result)].table(result)
    return f"{shown.caption}\n{report.markdown_table(shown)}"


def html(result: Any) -> str:
    """The table of a result as HTML; names in it are escaped."""
    shown = _VIEWS[type(result)].table(result)
    return render_page("table.html", provenance=None, table=shown)


def plot(result: Any, ax: Axes | None = None) -> Axes:
    """Draw a result into axes; by default into those of a new figure."""
    axes = new_figure(_HEIGHT).subplots() if ax is None else ax
    _VIEWS[type(result)].draw(result, axes)
    return axes


def frame(result: Any) -> Any:
    """A result as a data frame in SI units; without rows, it has its columns."""
    import pandas

    return pandas.DataFrame(_VIEWS[type(result)].columns(result))


def write_page(result: Any, path: str | Path) -> None:
    """Write a result as an HTML page."""
    if isinstance(result, Inspection):
        write_inspection(path, [result], provenance=provenance())
        return
    view, figure = _VIEWS[type(result)], new_figure(_HEIGHT)
    view.draw(result, figure.subplots())
    table, columns = view.table(result), view.columns(result)
    bare = replace(table, caption="")
    sections = [Section("What was found", table=bare, figure=figure)]
    if notes := view.notes(result):
        sections.append(Section("What to take care of", "\n\n".join(notes)))
    lines = zip(*columns.values(), strict=True)
    if rows := tuple(tuple(map(_cell, line)) for line in lines):
        sections.append(Section("All numbers", table=Table(tuple(columns), rows)))
    report.write_page(path, table.caption, sections, provenance=provenance())


def _cell(x: Any) -> str:
    return f"{x:.4g}".replace("-", "−") if isinstance(x, float) else str(x)


class View(NamedTuple):
    """How a kind of result shows itself: a table, columns in SI units, and a picture.

    ``notes`` are sentences for its page.
    """

    table: Callable[[Any], Table]
    columns: Callable[[Any], Mapping[str, Any]]
    draw: Callable[[Any, Axes], None]
    notes: Callable[[Any], Sequence[str]] = lambda _: ()


def _fit_columns(fit: Fit) -> dict[str, Any]:
    low, high = fit.estimate.interval()
    return {
        "unknown": fit.labels,
        "combination": fit.names,
        "unit": fit.units,
        "value": fit.estimate.theta,
        "std": fit.estimate.std,
        "low": low,
        "high": high,
    }


def _fit_notes(fit: Fit) -> list[str]:
    untold = (f"Not told by these logs: {x}" for x in fit.unidentifiable)
    return [*fit.warnings, *untold]


def _draw_fit(fit: Fit, ax: Axes) -> None:
    _draw_errors(fit.held_out, fit.model.robot.joints, ax)


def _draw_errors(rms: Mapping[str, Any], joints: Sequence[str], ax: Axes) -> None:
    known = stage_inks(list(rms))
    _bars(ax, rms, joints, [known.get(name, BEST) for name in rms])
    ax.set_ylabel("held-out RMS error [N·m]")


def _validation_columns(found: Validation) -> dict[str, Any]:
    count = len(found.rows)
    return {
        "model": [row.name for row in found.rows for _ in found.joints],
        "joint": list(found.joints) * count,
        "unit": list(found.units) * count,
        "rms": np.ravel([row.rms for row in found.rows]),
        "relative": np.ravel([row.relative for row in found.rows]),
    }


def _draw_validation(found: Validation, ax: Axes) -> None:
    _draw_errors({row.name: row.rms for row in found.rows}, found.joints, ax)


def _design_table(design: Design) -> Table:
    labels, _, errors = _design_columns(design).values()
    caption = (
        f"{counted(len(design.trajectories), 'motion')} of {design.robot.name}, "
        f"condition {design.condition:.3g}"
    )
    lines = tuple(zip(labels, (f"{x:.3g}" for x in errors), strict=True))
    return Table(("unknown", "standard error to expect"), lines, caption)


def _design_columns(design: Design) -> dict[str, Any]:
    base, errors = design.observation.base, design.standard_errors()
    names = "unknown", "combination", "standard_error"
    return dict(zip(names, (base.kept_labels, base.names, errors), strict=True))


def _draw_design(design: Design, ax: Axes) -> None:
    reference = design.trajectories[0].reference(design.rate)
    _lines(ax, reference.t, reference.q, design.robot.joints, "position [rad]")


def _calibration_columns(calibration: Calibration) -> dict[str, Any]:
    found, (low, high) = calibration.parameters, calibration.solution.interval()
    names = {"correction": "name", "unit": "unit", "value": "value", "std": "std"}
    return {
        **{title: [getattr(x, own) for x in found] for title, own in names.items()},
        "low": low,
        "high": high,
    }


def _draw_calibration(calibration: Calibration, ax: Axes) -> None:
    low, high = calibration.solution.interval()
    middle, place = (low + high) / 2, np.arange(len(low))
    ax.errorbar(place, 1e3 * middle, 5e2 * (high - low), fmt="o", color=BLUE, capsize=2)
    ax.axhline(0.0, color="#e3e3e3", linewidth=0.8)
    clean(ax, grid="y")
    names = [figure_text(x.name) for x in calibration.parameters]
    ax.set_xticks(place, names, rotation=90)
    ax.set_ylabel("correction [mm or mrad]")


def _inspection_table(inspection: Inspection) -> Table:
    found = joints_table([inspection])
    count = len(inspection.doubts)
    doubts = counted(count, "doubt") if count else "nothing against it"
    return replace(found, caption=f"{inspection.recording.source}: {doubts}")


def _inspection_columns(inspection: Inspection) -> dict[str, Any]:
    joints = inspection.as_dict()["joints"]
    return {x.name: [row[x.name] for row in joints] for x in fields(JointCoverage)}


def _draw_inspection(inspection: Inspection, ax: Axes) -> None:
    log = inspection.recording
    measured = log.tau if log.has_torque else log.q
    label = "torque [N·m]" if log.has_torque else "position [rad]"
    _lines(ax, log.t - log.t[0], measured, log.joints, label)


def _servos_table(servos: ServoFit) -> Table:
    return replace(gap_table(servos), caption=servos.sentence)


def _servos_columns(servos: ServoFit) -> dict[str, Any]:
    rows = [
        {"joint": each["joint"], "quantity": name, **number}
        for each in servos.as_dict()["servos"]
        for name, number in each.items()
        if name != "joint"
    ]
    return {name: [row[name] for row in rows] for name in rows[0]}


def _draw_servos(servos: ServoFit, ax: Axes) -> None:
    groups = {"file": servos.before, "found": servos.after, "encoder": servos.floor}
    millis = {name: 1000 * x for name, x in groups.items()}
    _bars(ax, millis, servos.robot.joints, [GREY, BEST, PALE])
    ax.set_ylabel("RMS error of replays [mrad]")


def _diagnosis_table(diagnosis: Diagnosis) -> Table:
    lines = tuple(
        (f"{x.share:.0%}", " or ".join(x.alternatives), ", ".join(probability(x)),
         " + ".join(x.joints), x.sentence)
        for x in diagnosis.findings
    )  # fmt: skip
    header = ("share", "effect", "certainty", "joint", "what it means")
    said = diagnosis.sentence or diagnosis.verdict.replace("_", " ")
    caption = f"{diagnosis.robot}: {said}"
    return Table(header, lines, caption, words=True)


def _diagnosis_columns(diagnosis: Diagnosis) -> dict[str, Any]:
    found = [(x, y) for x in diagnosis.findings for y in x.parameters]
    return {
        "effect": [x.effect for x, _ in found],
        "probability": [x.probability for x, _ in found],
        "joint": [y.joint for _, y in found],
        "parameter": [y.name for _, y in found],
        "value": [y.value for _, y in found],
        "unit": [y.unit for _, y in found],
        "low": [y.interval[0] for _, y in found],
        "high": [y.interval[1] for _, y in found],
        "determined": [y.determined for _, y in found],
    }


def _draw_diagnosis(diagnosis: Diagnosis, ax: Axes) -> None:
    groups: dict[str, Any] = {"as the file stands": diagnosis.rms}
    if diagnosis.unseen is not None:
        groups |= {"with what was found, unseen": diagnosis.unseen.after}
    groups |= {"noise": diagnosis.noise_floor}
    _bars(ax, groups, diagnosis.joints, [GREY, *[BEST] * (len(groups) - 2), PALE])
    ax.set_ylabel("gap, RMS [N·m]")


def _bars(
    ax: Axes, groups: Mapping[str, Any], joints: Sequence[str], inks: Sequence[str]
) -> None:
    """Draw a bar of each group at every joint."""
    width = 0.84 / len(groups)
    for k, ((name, height), ink) in enumerate(zip(groups.items(), inks, strict=True)):
        left = np.arange(len(joints)) - 0.42 + k * width
        ax.bar(left, height, 0.92 * width, align="edge", color=ink, label=name)
    clean(ax, grid="y")
    ax.set_xticks(range(len(joints)), [*map(figure_text, joints)], rotation=20)
    ax.legend(frameon=False, fontsize=8)


def _lines(ax: Axes, t: Any, x: Any, joints: tuple[str, ...], label: str) -> None:
    """Draw a line for each joint over time."""
    for j, joint in enumerate(joints):
        ax.plot(t, x[:, j], linewidth=0.9, label=figure_text(joint))
    clean(ax, grid="y")
    ax.margins(x=0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel(label)
    ax.legend(frameon=False, fontsize=8)


_VIEWS = {
    Fit: View(held_out_table, _fit_columns, _draw_fit, _fit_notes),
    Validation: View(
        report.table_from_validation, _validation_columns, _draw_validation
    ),
    Design: View(_design_table, _design_columns, _draw_design),
    Calibration: View(corrections_table, _calibration_columns, _draw_calibration),
    Inspection: View(_inspection_table, _inspection_columns, _draw_inspection),
    ServoFit: View(_servos_table, _servos_columns, _draw_servos),
    Diagnosis: View(_diagnosis_table, _diagnosis_columns, _draw_diagnosis),
}
