"""Show the inspection of logs: tables, a figure and a page."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.diagnosis.answer.diagnosis import listed
from hybrid.inspect import Inspection
from hybrid.recording import Recording
from hybrid.recording.reading import Used
from hybrid.report.output import Section, write_page
from hybrid.report.style import BLUE, GREY, PALE, Figure, lines_figure
from hybrid.report.table import Table
from hybrid.robot.chain import unit_of_slide

_MOST_UNTOLD = 6  # parameters in a sentence


def readings_tables(inspections: Sequence[Inspection]) -> list[Table]:
    """How files were read; one table for all logs that were read in the same way."""
    alike: dict[tuple[Any, ...], list[str]] = {}
    for x in inspections:
        reading = x.recording.reading
        if reading is not None:
            key = reading.kind, reading.preset, reading.columns, reading.aside
            alike.setdefault(key, []).append(Path(x.recording.source).name)
    every = [joint for x in inspections for joint in x.joints]
    slides = {joint.joint for joint in every if joint.units[0] == "m"}
    tables = []
    for (kind, preset, columns, aside), names in alike.items():
        rows = [
            (x.label, f"{x.channel} {x.joint}".strip(), *_unit(x, x.joint in slides))
            for x in columns
        ]
        rows += [(label, "set aside", "", why) for label, why in aside]
        more = f" and {len(names) - 1} more alike" if len(names) > 1 else ""
        caption = f"{names[0]}{more}: {kind}{f', preset {preset}' if preset else ''}"
        header = ("column", "read as", "unit", "")
        tables.append(Table(header, tuple(rows), caption, words=True))
    return tables


def _unit(column: Used, slides: bool) -> tuple[str, str]:
    """Unit of a column in its file, and how it was converted."""
    unit = column.unit.replace("*", "·")
    if not column.stated:
        unit = f"{unit_of_slide(unit) if slides else unit} (assumed)"
    if (column.factor, column.offset) == (1.0, 0.0):
        return unit, ""
    shift = f" + {column.offset:.6g}" if column.offset else ""
    return unit, f"× {column.factor:.6g}{shift}"


def clocks_table(inspections: Sequence[Inspection]) -> Table:
    """One line per log: duration, clock, channels and number of doubts."""
    rows = []
    for x in inspections:
        clock = x.clock
        wrong = sum(doubt.is_error for doubt in x.doubts)
        doubts = [f"{wrong} wrong"] * (wrong > 0)
        doubts += [f"{len(x.doubts) - wrong} in doubt"] * (len(x.doubts) > wrong)
        rows.append(
            (
                Path(x.recording.source).name,
                f"{clock.duration:.1f}",
                f"{clock.rate:.4g}",
                f"{clock.samples:,}",
                f"{clock.jitter:.1%}",
                f"{clock.missing:.1%}",
                str(clock.holes),
                ", ".join(x.recording.channels),
                ", ".join(doubts) or "–",
            )
        )
    header = ("log", "s", "Hz", "samples", "jitter", "missing", "holes", "channels")
    return Table((*header, "doubts"), tuple(rows))


def joints_table(inspections: Sequence[Inspection]) -> Table:
    """One line per joint: its motion and torque in all logs together."""
    usable = [x for x in inspections if x.joints]
    units = [x.units for x in usable[0].joints] if usable else []
    usual = units[0] if len(set(units)) == 1 else ("rad", "N·m")
    rows = []
    for each in zip(*(x.joints for x in usable), strict=True):
        weights = [x.clock.duration for x in usable]
        moving = float(np.average([x.moving for x in each], weights=weights))
        step = min(x.resolution for x in each)
        torque = [x.torque for x in each if x.torque]
        least = min((x[0] for x in torque), default=np.nan)
        most = max((x[1] for x in torque), default=np.nan)
        highest = max(x.high for x in each)
        turn, force = ("" if x in usual else f" {x}" for x in each[0].units)
        lag = [x.lag for x in each if x.lag is not None]
        cells = (
            f"{min(x.low for x in each):.3g} … {highest:.3g}{turn}",
            f"{max(x.fastest for x in each):.3g}{turn and f'{turn}/s'}",
            f"{moving:.0%}",
            f"{step:.2g}{turn}" if np.isfinite(step) else "–",
            f"{least:.3g} … {most:.3g}{force}" if torque else "–",
            f"{1000 * float(np.median(lag)):.0f}" if lag else "–",
        )
        rows.append((each[0].joint, *(x.replace("-", "−") for x in cells)))
    turn, force = usual
    header = ["joint", f"q, {turn}", f"fastest, {turn}/s", "moves"]
    header += [f"step of q, {turn}", f"torque, {force}", "q after command, ms"]
    return Table(tuple(header), tuple(rows))


def untold_sentences(inspections: Sequence[Inspection]) -> list[str]:
    """Sentences on what the logs do not determine."""
    usable = [x for x in inspections if x.joints]
    if not usable:
        return []
    sentences = []
    together = list(zip(*(x.joints for x in usable), strict=True))
    still = [each[0].joint for each in together if not any(x.moving for x in each)]
    if still:
        sentences.append(
            f"No log moves {', '.join(still)}: friction and rotor there stay unknown."
        )
    if not any(x.recording.has_torque for x in usable):
        sentences.append(
            "Without torque, masses and friction are known up to the servo's gain only."
        )
    excited = [(x.excitation, x.recording.source) for x in usable if x.excitation]
    if excited:
        found, source = min(excited, key=lambda pair: len(pair[0].untold))
        told = len(found.names) - len(found.untold)
        rest = list(found.untold[:_MOST_UNTOLD])
        if len(found.untold) > len(rest):
            rest.append(f"{len(found.untold) - len(rest)} more")
        sentences.append(
            f"The best log alone, {Path(source).name}, tells {told} of "
            f"{len(found.names)} parameters of links and drives from zero (condition "
            f"number {found.condition:.0f}){f'; not {listed(rest)}' if rest else ''}."
        )
    return sentences


def doubts_table(inspections: Sequence[Inspection]) -> Table:
    """All doubts about the logs, errors first."""
    found = [(Path(x.recording.source).name, d) for x in inspections for d in x.doubts]
    found.sort(key=lambda pair: not pair[1].is_error)
    rows = [("wrong" if d.is_error else "in doubt", name, d.line) for name, d in found]
    return Table(("", "log", "what, and what is valid"), tuple(rows), words=True)


def log_figure(recording: Recording) -> Figure:
    """Draw position and command of every joint over time, and torque or speed below."""
    joints, t = recording.joints, recording.t - recording.t[0]
    position = [("position", recording.q, BLUE, 0.9)]
    if recording.command is not None:
        position.insert(0, ("command", recording.command, PALE, 2.0))
    rows = {"position\n[rad]": position}
    if recording.has_torque:
        rows["torque\n[N·m]"] = [("torque", recording.tau, GREY, 0.7)]
    elif recording.v is not None:
        rows["speed\n[rad/s]"] = [("speed", recording.v, GREY, 0.7)]
    return lines_figure(t, joints, rows, 0.85 * len(rows) + 0.3)[0]


def write_inspection(
    path: str | Path,
    inspections: Sequence[Inspection],
    *,
    provenance: Mapping[str, Any],
) -> None:
    """Write the page of the inspection of some logs."""
    doubts = doubts_table(inspections)
    longest = max(inspections, key=lambda x: x.clock.duration).recording
    readings = readings_tables(inspections)
    sections = [
        Section("What the joints do", table=joints_table(inspections)),
        Section("Clocks", table=clocks_table(inspections)),
        Section(
            "The longest log",
            figure=log_figure(longest),
            caption=f"Every joint of {Path(longest.source).name}.",
        ),
        Section(
            "What these logs cannot tell",
            "\n\n".join(untold_sentences(inspections)) or "Nothing stands out.",
        ),
    ]
    sections += [Section("How files were read", table=x) for x in readings]
    if doubts.rows:
        sections.insert(0, Section("What speaks against the logs", table=doubts))
    lead = verdict(inspections)
    write_page(path, "Inspection of logs", sections, lead=lead, provenance=provenance)


def verdict(inspections: Sequence[Inspection]) -> str:
    """Say in a sentence whether the logs may be used."""
    wrong = [x for x in inspections if x.misleads]
    seconds = sum(x.clock.duration for x in inspections)
    logs = f"{len(inspections)} log{'s' * (len(inspections) > 1)}, {seconds:.0f} s"
    if wrong:
        return f"{logs}: {len(wrong)} would mislead."
    doubted = sum(bool(x.doubts) for x in inspections)
    if doubted:
        return f"{logs}: usable; {doubted} with something to look at."
    return f"{logs}: nothing speaks against them."
