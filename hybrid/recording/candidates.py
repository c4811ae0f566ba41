"""Find the columns of each channel by the map or by the words of labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from hybrid.errors import RecordingError
from hybrid.recording.mapping import Mapping
from hybrid.recording.recording import CHANNELS
from hybrid.recording.words import Meaning, meaning, split_unit

HELP = "or say which column is what with --map FILE.yaml"


@dataclass(frozen=True)
class Column:
    """A column that is a channel of some joint."""

    index: int
    label: str
    said: Meaning


def columns_of(
    labels: Sequence[str],
    mapping: Mapping,
    joints: tuple[str, ...],
    time: int,
    place: str,
) -> tuple[dict[str, list[Column]], dict[int, str]]:
    """Find the columns of each channel.

    Args:
        labels: Labels of the table.
        mapping: What the user and the preset say.
        joints: Names of joints that are known.
        time: Index of the column of time.
        place: Words for the table, for messages.

    Returns:
        Columns of each channel that has some; and why others are none, by index.

    Raises:
        RecordingError: The user's map names a column that is not there.
    """
    spoken, aside = _spoken(labels, mapping, (*joints, *mapping.names), time)
    found: dict[str, list[Column]] = {}
    for channel in CHANNELS:
        if not mapping.source(channel).dropped:
            mapped = _mapped(labels, mapping, channel, place)
            found[channel] = mapped or spoken.get(channel, [])
    if not found.get("tau") and not mapping.source("tau").dropped:
        found["tau"] = spoken.get("current", [])
    taken = {c.index for columns in found.values() for c in columns}
    aside |= {
        c.index: "current, beside a torque"
        for c in spoken.get("current", [])
        if c.index not in taken
    }
    return {name: columns for name, columns in found.items() if columns}, aside


def listed(labels: Sequence[str]) -> str:
    """Labels for a message: a dozen, and how many more."""
    shown = ", ".join(label[:80] for label in labels[:12])
    return shown if len(labels) <= 12 else f"{shown} and {len(labels) - 12} more"


def _spoken(
    labels: Sequence[str], mapping: Mapping, known: tuple[str, ...], time: int
) -> tuple[dict[str, list[Column]], dict[int, str]]:
    """Columns by their words."""
    said = {k: meaning(x, known) for k, x in enumerate(labels) if k != time}
    # Of an arm with one joint, columns may be called just q and tau.
    single = any(m.channel == "q" and not m.joint for m in said.values())
    spoken: dict[str, list[Column]] = {}
    aside: dict[int, str] = {}
    for k, m in said.items():
        if m.channel and not m.joint and single:
            m = replace(m, number=1, joint="1")
        if not labels[k].strip("/").startswith(mapping.topic.strip("/")):
            aside[k] = f"not of {mapping.topic}"
        elif not m.channel:
            aside[k] = m.why
        elif m.joint:
            spoken.setdefault(m.channel, []).append(Column(k, labels[k], m))
    return spoken, aside


def _mapped(
    labels: Sequence[str], mapping: Mapping, channel: str, place: str
) -> list[Column]:
    """Columns by the map's pattern, list or table of joints."""
    columns = mapping.source(channel).columns
    if columns is None:
        return []
    if isinstance(columns, str):
        found = []
        start, _, end = columns.partition("{}")
        for k, label in enumerate(labels):
            for text in (label, split_unit(label)[0]):
                joint = text[len(start) : len(text) - len(end)]
                if text == start + joint + end and bool(joint) == ("{}" in columns):
                    found.append(_column(k, label, channel, joint or "1"))
                    break
        if not found and mapping.own(channel):
            raise RecordingError(
                f"{place}: no column like {columns!r} for {channel} of "
                f"{mapping.origin} among {listed(labels)}"
            )
        return found
    if isinstance(columns, tuple):
        columns = {str(k + 1): label for k, label in enumerate(columns)}
    if missing := [name for name in columns.values() if name not in labels]:
        raise RecordingError(
            f"{place}: no column {missing[0]!r} for {channel} of {mapping.origin} "
            f"among {listed(labels)}"
        )
    return [
        _column(labels.index(label), label, channel, joint)
        for joint, label in columns.items()
    ]


def _column(index: int, label: str, channel: str, joint: str) -> Column:
    number = int(joint) if joint.isascii() and joint.isdigit() else None
    unit = split_unit(label)[1]
    return Column(index, label, Meaning(channel, joint, number, unit=unit, why=""))
