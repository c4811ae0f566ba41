"""One mapping for every format: a table, a map and the labels' words -> columns.

For each channel, the map's columns come first; where it has none, the labels' words
decide. Joints are told by name where columns have names, else by number. A unit is the
map's, else the label's, else the file's, else the one of SI.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

from hybrid.errors import HybridWarning, RecordingError
from hybrid.names import printable
from hybrid.recording.candidates import HELP, Column, columns_of, listed
from hybrid.recording.joints import MatchedJoints, match_joints
from hybrid.recording.mapping import Mapping, preset_of
from hybrid.recording.reading import Reading, Used
from hybrid.recording.recording import CHANNELS, joint_mismatch, numbered_joints
from hybrid.recording.table import MOST_COLUMNS, LogTable
from hybrid.recording.units import SI, converted
from hybrid.recording.words import (
    CHANNEL_WORDS,
    LONGEST,
    TIME,
    is_time,
    split_unit,
)

_NEEDED = ("q", "tau")
MOST = LONGEST + 1  # characters of a label that are kept


@dataclass(frozen=True)
class Decision:
    """Columns of each channel in the order of the joints, and how it came about."""

    joints: tuple[str, ...]
    time: Used
    channels: dict[str, tuple[Used, ...]]
    reading: Reading


def decide(
    table: LogTable,
    *,
    joints: tuple[str, ...] | None = None,
    mapping: Mapping | None = None,
    torque: bool = True,
    quiet: bool = False,
) -> Decision:
    """Decide which column of a table is which channel of which joint in which unit.

    Args:
        table: Named columns.
        joints: Joint names of the robot, base to tip; None if not known.
        mapping: What the user says.
        torque: Whether torques must be there.
        quiet: Whether to keep the warning about columns set aside.

    Raises:
        RecordingError: Time, positions or torques are missing, two columns are for the
            same joint, a unit fits no channel, or the joints are not the robot's.

    Warns:
        HybridWarning: Columns were set aside; they are listed.
    """
    return _Decider(table, joints, mapping or Mapping(), torque).decide(quiet)


class _Decider:
    """The steps of one decision; what is set aside is gathered along the way."""

    def __init__(
        self,
        table: LogTable,
        joints: tuple[str, ...] | None,
        mapping: Mapping,
        torque: bool,
    ) -> None:
        if len(table.labels) > MOST_COLUMNS:
            raise RecordingError(
                f"{table.place}: {len(table.labels)} columns; valid are up to "
                f"{MOST_COLUMNS}"
            )
        labels = tuple(printable(label.strip())[:MOST] for label in table.labels)
        found = preset_of(labels, mapping.preset or table.preset)
        self.table, self.labels, self.torque = table, labels, torque
        self.map = mapping.over(found)
        self.joints = joints or self.map.joints or table.joints or None
        self.aside: dict[int, str] = {}
        self.notes = [table.note] if table.note else []

    def decide(self, quiet: bool) -> Decision:
        time = self.time()
        columns = self.columns(time.index)
        self._check_needed(columns)
        joints = self.joints or self._joints_of(columns)
        channels: dict[str, tuple[Used, ...]] = {}
        for channel in CHANNELS:
            if placed := self.placed(channel, columns.get(channel, []), joints):
                channels[channel] = placed
        if self.torque and "tau" not in channels:
            raise self._missing("tau")
        taken = {u.index for used in channels.values() for u in used} | {time.index}
        aside = {
            k: self.aside.get(k, "not used")
            for k, label in enumerate(self.labels)
            if label and k not in taken
        }
        if not quiet:
            self._warn([self.labels[k] for k in aside], channels["q"])
        used = (time, *(u for group in channels.values() for u in group))
        reading = Reading(
            self.table.kind, self.table.name, self.map.preset, used,
            tuple((self.labels[k], why) for k, why in aside.items()),
            tuple(self.notes),
        )  # fmt: skip
        return Decision(joints, time, channels, reading)

    def _warn(self, aside: list[str], positions: tuple[Used, ...]) -> None:
        """Say once for a file what was set aside, and which unit nobody knows."""
        home = self.table.home or self.table.place
        lines = [f"ignored columns: {listed(aside)}"] if aside else []
        if self.map.preset == "lerobot" and not positions[0].stated:
            lines.append(
                "units are not in a LeRobot dataset: positions are taken as radians; "
                "if they are degrees, use --map FILE.yaml with q: {unit: deg}, "
                "command: {unit: deg}"
            )
        for line in lines:
            warnings.warn(f"{home}: {line}", HybridWarning, stacklevel=6)

    def _error(self, text: str) -> RecordingError:
        return RecordingError(f"{self.table.place}: {text}")

    def time(self) -> Used:
        """The column of time, or one of index -1 if the map gives a rate."""
        source = self.map.source("time")
        if "rate" in source.factors:
            step = 1 / source.factor("time", 0)
            return Used(-1, "", "t", "", "s", True, step)
        if source.columns is not None and (not self.map.preset or "time" in str(
            source.columns) or source.columns in self.labels):  # fmt: skip
            found = [k for k, x in enumerate(self.labels) if x == source.columns]
            what = f"no column {source.columns!r}"
        else:
            words = [split_unit(label)[0] for label in self.labels]
            exact = [k for k, word in enumerate(words) if word.lower() in TIME]
            found = exact or [k for k, word in enumerate(words) if is_time(word)]
            what = "no column of time" if not found else "more than one column of time"
        if len(found) != 1:
            raise self._error(
                f"{what} among {listed(self.labels)}; valid is one of "
                f"{', '.join(TIME)}, in seconds or with its unit (time_ms), {HELP}"
            )
        label = self.labels[found[0]]
        unit = source.unit or split_unit(label)[1] or self.table.unit(found[0])
        if unit and converted(unit, "time") is None:
            raise self._unit_error(label, unit, "time")
        return Used(found[0], label, "t", "", unit, bool(unit))

    def columns(self, time: int) -> dict[str, list[Column]]:
        """Columns of each channel, not yet of joints."""
        found, aside = columns_of(
            self.labels, self.map, self.joints or (), time, self.table.place
        )
        self.aside |= aside
        return found

    def _check_needed(self, columns: dict[str, list[Column]]) -> None:
        for channel in _NEEDED if self.torque else ("q",):
            if not columns.get(channel):
                raise self._missing(channel)

    def _missing(self, channel: str) -> RecordingError:
        word = "positions" if channel == "q" else "torques"
        currents = [k for k, why in self.aside.items() if why.startswith("current")]
        if channel == "tau" and currents:
            labels = listed([self.labels[k] for k in currents])
            return self._error(
                f"no torques, but currents ({labels}); valid is --map FILE.yaml with "
                "tau: {torque_constant: N·m/A, gear_ratio: ...}, each a number or a "
                "list in the order of the joints"
            )
        words = (w for w in CHANNEL_WORDS[channel].split()[:3] if w != "tauj")
        return self._error(
            f"no {word} among the columns {listed(self.labels)}; valid are "
            f"{', '.join(f'{w}1 or {w}_<joint>' for w in words)}, {HELP}"
        )

    def _joints_of(self, columns: dict[str, list[Column]]) -> tuple[str, ...]:
        """Joint names of the file: those of the first channel that has names."""
        for channel in _NEEDED:
            group = self._numbered_first(columns.get(channel, []))
            names = [c.said.joint for c in group if c.said.number is None]
            if names:
                return tuple(dict.fromkeys(self.map.names.get(x, x) for x in names))
        group = self._numbered_first(columns["q"])
        return numbered_joints(len({c.said.joint for c in self._one_space(group)}))

    def _numbered_first(self, columns: list[Column]) -> list[Column]:
        """Without names beside numbers: q_motor1 beside q1 is no joint."""
        numbered = [c for c in columns if c.said.number is not None]
        for c in columns:
            if numbered and c.said.number is None:
                self.aside[c.index] = "a name beside numbered joints"
        return numbered or columns

    def _one_space(
        self, columns: list[Column], joints: tuple[str, ...] | None = None
    ) -> list[Column]:
        """The columns under one topic or group: the one that has the joints."""
        spaces = dict.fromkeys(c.said.space for c in columns)
        if len(spaces) < 2:
            return columns
        groups = {s: [c for c in columns if c.said.space == s] for s in spaces}
        good = {
            s: group
            for s, group in groups.items()
            if joints is None or not self._match(group, joints).missing
        }
        if "" in good:  # the plain names: q1 beside motor_position_1
            good = {"": good[""]}
        if len(good) != 1:
            raise self._error(
                f"columns of {columns[0].said.channel} under {listed(list(spaces))}"
                f", {len(good) or 'none'} of them for the joints; valid is --map "
                "FILE.yaml with topic: and the beginning of the right ones"
            )
        ((space, group),) = good.items()
        for c in columns:
            if c.said.space != space:
                self.aside[c.index] = f"not of {space or 'the joints'}"
        return group

    def _match(self, group: list[Column], joints: tuple[str, ...]) -> MatchedJoints:
        names = [self.map.names.get(c.said.joint, c.said.joint) for c in group]
        return match_joints(names, [c.said.number for c in group], joints)

    def placed(
        self, channel: str, columns: list[Column], joints: tuple[str, ...]
    ) -> tuple[Used, ...]:
        """Columns of one channel in the order of the joints, with their units."""
        if not columns:
            return ()
        named = self._match(columns, joints)
        if named.missing:
            columns = self._numbered_first(columns)
        columns = self._one_space(columns, joints)
        match = self._match(columns, joints)
        places: dict[str, Column] = {}
        for column, joint in zip(columns, match.joints, strict=True):
            if joint in places:
                raise self._error(
                    f"columns {places[joint].label!r} and {column.label!r} are both "
                    f"{channel} of {joint}; valid is one column for each joint, {HELP}"
                )
            places[joint] = column
        extra = [joint for joint in places if joint not in joints]
        if channel not in _NEEDED and len(extra) == len(places):
            self.aside |= {c.index: "of no joint of the arm" for c in columns}
            return ()
        if match.missing or (extra and places[extra[0]].said.number is not None):
            raise self._error(
                f"columns of {channel} ({listed([c.label for c in columns])}): "
                f"{joint_mismatch(tuple(places), joints)}"
            )
        for joint in extra:
            self.aside[places.pop(joint).index] = f"{joint} is no joint of the arm"
        return self._used(channel, [places[joint] for joint in joints], joints)

    def _used(
        self, channel: str, columns: Sequence[Column], joints: tuple[str, ...]
    ) -> tuple[Used, ...]:
        """Columns of a channel with their units; none if they are but currents."""
        source, used = self.map.source(channel), []
        for place, (column, joint) in enumerate(zip(columns, joints, strict=True)):
            unit = self._unit(channel, column)
            known = converted(unit or SI[channel][0], channel)
            if channel == "tau" and (current := converted(unit, "current")):
                if "torque_constant" not in source.factors:
                    if not self._bare_current(column):
                        raise self._unit_error(column.label, unit, channel)
                    why = f"current in {unit}: a map with a torque_constant is needed"
                    self.aside |= {c.index: why for c in columns}
                    return ()
                known = current
            elif known is None or "torque_constant" in source.factors:
                raise self._unit_error(column.label, unit, channel)
            factor = known[0] * source.factor(joint, place)
            words = (column.index, column.label, channel, joint)
            shown = unit or SI[channel][0]
            used.append(Used(*words, shown, bool(unit), factor, known[1]))
        return tuple(used)

    def _unit(self, channel: str, column: Column) -> str:
        """Unit of a column: the user's, the label's, the file's, the preset's."""
        source = self.map.source(channel)
        stated = (source.unit, column.said.unit, self.table.unit(column.index))
        if not self.map.own(channel):  # what a file states is above a preset
            stated = (*stated[1:], source.unit)
        unit = next(filter(None, stated), "")
        current = (
            column.said.channel == "current" or "torque_constant" in source.factors
        )
        return "A" if current and not unit else unit

    def _bare_current(self, column: Column) -> bool:
        """Whether a current is set aside, not refused as the torque it should be."""
        of_preset = bool(self.map.preset) and not self.map.own("tau")
        return not self.torque or column.said.channel == "current" or of_preset

    def _unit_error(self, label: str, unit: str, channel: str) -> RecordingError:
        valid = " and ".join(SI[channel])
        more = ", or a current with torque_constant in --map FILE.yaml"
        return self._error(
            f"column {label!r} is in {unit}; valid are {valid} and units that convert "
            f"to them{more if channel == 'tau' else ''}"
        )


def decide_command(
    table: LogTable, joints: tuple[str, ...], mapping: Mapping
) -> Decision | None:
    """Columns of the command alone, for a stream without positions; None if none.

    Args:
        table: Named columns.
        joints: Joints of the recording that the command is for.
        mapping: What the user says of channels; its topic does not count here.
    """
    decider = _Decider(table, joints, replace(mapping, topic=""), torque=False)
    try:
        time = decider.time()
        columns = decider.columns(time.index).get("command", [])
        used = decider.placed("command", columns, joints)
    except RecordingError:
        return None
    reading = Reading(table.kind, table.name, "", (time, *used))
    return Decision(joints, time, {"command": used}, reading) if used else None
