"""Show servos that were fitted by replay: tables, a figure and a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.report.output import Section, write_page
from hybrid.report.style import BLACK, BLUE, PALE, RED, Figure, lines_figure
from hybrid.report.table import Table
from hybrid.servo.drive import QUANTITIES
from hybrid.servo.servo_fit import ServoFit, ServoReplay


def gap_table(fit: ServoFit) -> Table:
    """Error of replays of held-out motion at each joint, [mrad]."""
    errors = fit.before, fit.plain, fit.after, fit.floor
    rows = [
        (joint, *(f"{1000 * x[j]:.2f}" for x in errors))
        for j, joint in enumerate(fit.robot.joints)
    ]
    moving = np.array([x not in fit.resting for x in fit.robot.joints])
    label = "mean" if moving.all() else "mean of joints that move"
    rows.append((label, *(f"{1000 * x[moving].mean():.2f}" for x in errors)))
    caption = (
        f"RMS error of open-loop replays of {fit.seconds:.0f} s unseen motion, mrad"
    )
    header = ("joint", "file", "plain fit", "found", "encoder")
    return Table(header, tuple(rows), caption)


def findings_table(fit: ServoFit) -> Table:
    """Wrong numbers in the robot's file, most important first."""
    rows = [
        (
            x.joint,
            x.quantity.replace("_", " "),
            f"{x.file:.4g}",
            f"{x.value:.4g}",
            f"{x.interval[0]:.4g} … {x.interval[1]:.4g}",
            x.unit,
            f"{1000 * x.worth:.2f}",
            " or ".join((x.effect, *x.equivalents)).replace("_", " "),
        )
        for x in fit.findings
    ]
    header = ("joint", "number", "file", "found", "95 %", "unit", "worth, mrad")
    return Table((*header, "effect"), tuple(rows))


def servos_table(fit: ServoFit) -> Table:
    """All parameters of all servos, with 95 % intervals; zeros are told once."""
    rows, zeros = [], []
    for k, each in enumerate(QUANTITIES):
        name, cells = each.name.replace("_", " "), []
        if not (fit.drive[each.name].any() or fit.std[k].any()):
            zeros.append(name)
            continue
        none = fit.drive.unlimited & (each.name == "stall")
        for j, (x, std) in enumerate(
            zip(fit.drive[each.name], fit.std[k], strict=True)
        ):
            low, high = map(_plain, each.interval(x, std))
            own = f"{_plain(x)} ({low} … {high})" if std else _plain(x)
            cells.append("none" if none[j] else own)
        rows.append((f"{name}, {each.unit}" if each.unit else name, *cells))
    caption = f"Zero at every joint: {', '.join(zeros)}" if zeros else ""
    return Table(("", *fit.robot.joints), tuple(rows), caption)


def _plain(x: float) -> str:
    """Three digits, 1230 and not 1.23e+03."""
    return f"{float(f'{x:.3g}'):g}"


def replay_figure(replay: ServoReplay, joints: Sequence[str]) -> Figure:
    """Draw the position of every joint, measured and replayed."""
    curves = [
        ("command", replay.command, PALE, 1.8),
        ("simulator, file", replay.before, RED, 0.8),
        ("simulator, found", replay.after, BLUE, 1.0),
        ("measured", replay.q, BLACK, 0.9),
    ]
    return lines_figure(replay.t, joints, {"position [rad]": curves}, 1.6)[0]


def write_servo_page(
    path: str | Path,
    fit: ServoFit,
    replay: ServoReplay,
    *,
    fixed: str,
    provenance: Mapping[str, Any],
) -> None:
    """Write the page of a servo fit; ``fixed`` is the simulator beside it."""
    head, _, causes = fit.sentence.partition(": ")
    remedy = (
        f"Simulate with {fixed}, which lies beside this page: it has these numbers, as "
        "far as MJCF can express them. Then diagnose it with other logs.\n\n"
        "Worth: by how much unseen replays get worse with the file's number."
    )
    nothing = "Nothing: no number of the file is certainly wrong."
    sections = [
        Section(
            "What to do",
            remedy if fit.findings else nothing,
            table=findings_table(fit) if fit.findings else None,
        ),
        Section("How far replays miss", table=gap_table(fit)),
        Section(
            "An unseen motion",
            figure=replay_figure(replay, fit.robot.joints),
            caption=f"{Path(replay.source).name}: replayed from its first state.",
        ),
        Section("What these logs cannot tell", "\n\n".join(f"{x}." for x in fit.notes)),
        Section("All numbers", table=servos_table(fit)),
    ]
    title = f"{fit.robot.name}: {head[:1].lower()}{head[1:]}"
    lead = causes[:1].upper() + causes[1:]
    write_page(path, title, sections, lead=lead, provenance=provenance)
