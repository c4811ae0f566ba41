"""Which column of a table is which channel of which joint, in which unit.

The map decides, or else the words of the label; then joints are matched to the robot's,
and units are those of the map, the label, the file, the format or SI, in this order.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

from hybrid.errors import HybridWarning, RecordingError
from hybrid.names import printable
from hybrid.recording.joints import match_joints
from hybrid.recording.mapping import Mapping, preset_of
from hybrid.recording.reading import Reading, Used
from hybrid.recording.recording import CHANNELS, joint_mismatch, numbered_joints
from hybrid.recording.table import MOST_COLUMNS, LogTable, NoJointsError
from hybrid.recording.units import SI, converted
from hybrid.recording.words import (
    CHANNEL_WORDS,
    LONGEST,
    TIME,
    Meaning,
    is_time,
    meaning,
    split_unit,
)

_HELP = "or say which column is what with --map FILE.yaml"
_NEEDED = ("q", "tau")


class Decider:
    """The steps of one decision; what is set aside is gathered along the way.

    Joints are the robot's, base to tip, if they are known; ``torque`` says whether
    torques must be there.
    """

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
        # One character more than the longest label that may have a meaning.
        labels = tuple(printable(x.strip())[: LONGEST + 1] for x in table.labels)
        found = preset_of(labels, mapping.preset or table.preset)
        self.table, self.labels, self.torque = table, labels, torque
        self.map = mapping.over(found)
        self.joints = joints or self.map.joints or table.joints or ()
        self.aside: dict[int, str] = {}

    def decide(self, *, quiet: bool = False) -> Reading:
        """What each column is.

        Raises:
            NoJointsError: Positions are missing.
            RecordingError: Time or torques are missing, two columns are for the same
                joint, a unit fits no channel, or joints are not the robot's.

        Warns:
            HybridWarning: Columns were set aside; they are listed unless ``quiet``.
        """
        try:
            time = self._time()
        except RecordingError as error:
            if self._columns(-1)["q"]:
                raise
            raise NoJointsError(str(error)) from None
        columns = self._columns(time.index)
        needed = _NEEDED if self.torque else _NEEDED[:1]
        joints, used = self.joints or self._joints_of(columns), [time]
        for channel in CHANNELS:
            placed = self._placed(channel, columns[channel], joints)
            if channel in needed and not placed:
                raise self._missing(channel)
            used += placed
        taken = {u.index for u in used}
        aside = {
            k: self.aside.get(k, "not used")
            for k, label in enumerate(self.labels)
            if label and k not in taken
        }
        if not quiet:
            self._warn([self.labels[k] for k in aside], stated=used[1].stated)
        return Reading(
            self.table.kind, self.table.name, self.map.preset, tuple(used),
            tuple((self.labels[k], why) for k, why in aside.items()),
            (self.table.note,) if self.table.note else (),
        )  # fmt: skip

    def command(self) -> Reading | None:
        """Columns of the command alone, for a stream without positions, if any."""
        try:
            time = self._time()
            columns = self._columns(time.index)["command"]
            used = self._placed("command", columns, self.joints)
        except RecordingError:
            return None
        table = self.table
        return Reading(table.kind, table.name, "", (time, *used)) if used else None

    def _warn(self, aside: list[str], stated: bool) -> None:
        """Say once for a file what was set aside, and which unit nobody knows."""
        home = self.table.home or self.table.place
        lines = [f"ignored columns: {_listed(aside)}"] if aside else []
        if self.map.preset == "lerobot" and not stated:
            lines.append(
                "units are not in a LeRobot dataset: positions are taken as radians; "
                "if they are degrees, use --map FILE.yaml with q: {unit: deg}, "
                "command: {unit: deg}"
            )
        for line in lines:
            warnings.warn(f"{home}: {line}", HybridWarning, stacklevel=5)

    def _label(self, column: Meaning) -> str:
        return self.labels[column.index]

    def _error(self, text: str) -> RecordingError:
        return RecordingError(f"{self.table.place}: {text}")

    def _time(self) -> Used:
        """The column of time, or one of index -1 if the map gives a rate."""
        source, name = self.map.source("time"), self.map.source("time").columns
        if "rate" in source.factors:
            step = 1 / source.factor("time", 0)
            return Used(-1, "", "t", "", "s", True, step)
        if name is not None and (self.map.own("time") or name in self.labels):
            found = [k for k, x in enumerate(self.labels) if x == name]
            what = f"no column {name!r}"
        else:
            words = [split_unit(label)[0] for label in self.labels]
            exact = [k for k, word in enumerate(words) if word.lower() in TIME]
            found = exact or [k for k, word in enumerate(words) if is_time(word)]
            what = "no column of time" if not found else "more than one column of time"
        if len(found) != 1:
            raise self._error(
                f"{what} among {_listed(self.labels)}; valid is one of "
                f"{', '.join(TIME)}, in seconds or with its unit (time_ms), {_HELP}"
            )
        label = self.labels[found[0]]
        unit = source.unit or split_unit(label)[1] or self.table.unit(found[0])
        if unit and converted(unit, "time") is None:
            raise self._unit_error(label, unit, "time")
        return Used(found[0], label, "t", "", unit, bool(unit))

    def _columns(self, time: int) -> dict[str, list[Meaning]]:
        """Columns of each channel, by the map or by their words, not yet of joints."""
        spoken, found = self._spoken(time), {}
        for channel in CHANNELS:
            dropped = self.map.source(channel).dropped
            mapped = [] if dropped else self._mapped(channel)
            found[channel] = mapped or ([] if dropped else spoken.get(channel, []))
        currents = spoken.get("current", [])
        if not found["tau"] and not self.map.source("tau").dropped:
            found["tau"] = currents
        taken = {c.index for columns in found.values() for c in columns}
        for c in currents:
            if c.index not in taken:
                self.aside[c.index] = "current, beside a torque"
        return found

    def _spoken(self, time: int) -> dict[str, list[Meaning]]:
        """Columns by their words."""
        known, topic = (*self.joints, *self.map.names), self.map.topic.strip("/")
        said = {k: meaning(x, known) for k, x in enumerate(self.labels) if k != time}
        # Of an arm with one joint, columns may be called just q and tau.
        single = any(m.channel == "q" and not m.joint for m in said.values())
        spoken: dict[str, list[Meaning]] = {}
        for k, m in said.items():
            if m.channel and not m.joint and single:
                m = replace(m, number=1, joint="1")
            if not self.labels[k].strip("/").startswith(topic):
                self.aside[k] = f"not of {self.map.topic}"
            elif not m.channel:
                self.aside[k] = m.why
            elif m.joint:
                spoken.setdefault(m.channel, []).append(replace(m, index=k))
        return spoken

    def _mapped(self, channel: str) -> list[Meaning]:
        """Columns by the map's pattern, or its table of joints."""
        source, where = self.map.source(channel), f"{channel} of {self.map.origin}"
        if source.columns is None:
            return []
        try:
            found = source.found(self.labels)
            if not found and self.map.own(channel):
                raise ValueError(f"no column like {source.columns!r}")
        except ValueError as error:
            among = _listed(self.labels)
            raise self._error(f"{error} for {where} among {among}") from error
        columns = []
        for k, joint in found.items():
            number = int(joint) if joint.isascii() and joint.isdigit() else None
            unit = split_unit(self.labels[k])[1]
            columns.append(Meaning(channel, joint, number, "", unit, "", k))
        return columns

    def _missing(self, channel: str) -> RecordingError:
        word = "positions" if channel == "q" else "torques"
        currents = [self.labels[k] for k, why in self.aside.items()
                    if why.startswith("current")]  # fmt: skip
        if channel == "tau" and currents:
            return self._error(
                f"no torques, but currents ({_listed(currents)}); valid is --map "
                "FILE.yaml with tau: {torque_constant: N·m/A, gear_ratio: ...}, each a "
                "number or a list in the order of the joints"
            )
        words = [w for w in CHANNEL_WORDS[channel].split()[:3] if w != "tauj"]
        kind = NoJointsError if channel == "q" else RecordingError
        return kind(
            f"{self.table.place}: no {word} among the columns {_listed(self.labels)}; "
            f"valid are {', '.join(f'{w}1 or {w}_<joint>' for w in words)}, {_HELP}"
        )

    def _joints_of(self, columns: dict[str, list[Meaning]]) -> tuple[str, ...]:
        """Joint names of the file: those of the first channel that has names."""
        for channel in _NEEDED:
            group = self._numbered_first(columns[channel])
            names = [c.joint for c in group if c.number is None]
            if names:
                return tuple(dict.fromkeys(self.map.names.get(x, x) for x in names))
        group = self._numbered_first(columns["q"])
        return numbered_joints(len({c.joint for c in self._one_space(group)}))

    def _numbered_first(self, columns: list[Meaning]) -> list[Meaning]:
        """Without names beside numbers: q_motor1 beside q1 is no joint."""
        numbered = [c for c in columns if c.number is not None]
        for c in columns:
            if numbered and c.number is None:
                self.aside[c.index] = "a name beside numbered joints"
        return numbered or columns

    def _one_space(
        self, columns: list[Meaning], joints: tuple[str, ...] = ()
    ) -> list[Meaning]:
        """The columns under one topic or group: the one that has the joints."""
        groups: dict[str, list[Meaning]] = {}
        for c in columns:
            groups.setdefault(c.space, []).append(c)
        if len(groups) < 2:
            return columns
        good = [s for s, group in groups.items()
                if {*joints} <= {*self._match(group, joints)}]  # fmt: skip
        if "" in good:  # the plain names: q1 beside motor_position_1
            good = [""]
        if len(good) != 1:
            raise self._error(
                f"columns of {columns[0].channel} under {_listed([*groups])}"
                f", {len(good) or 'none'} of them for the joints; valid is --map "
                "FILE.yaml with topic: and the beginning of the right ones"
            )
        for c in columns:
            if c.space != good[0]:
                self.aside[c.index] = f"not of {good[0] or 'the joints'}"
        return groups[good[0]]

    def _match(self, group: list[Meaning], joints: tuple[str, ...]) -> tuple[str, ...]:
        names = [self.map.names.get(c.joint, c.joint) for c in group]
        return match_joints(names, [c.number for c in group], joints)

    def _placed(
        self, channel: str, columns: list[Meaning], joints: tuple[str, ...]
    ) -> list[Used]:
        """Columns of one channel in the order of the joints, with their units."""
        if not columns:
            return []
        if not {*joints} <= {*self._match(columns, joints)}:
            columns = self._numbered_first(columns)
        columns = self._one_space(columns, joints)
        places: dict[str, Meaning] = {}
        for column, joint in zip(columns, self._match(columns, joints), strict=True):
            if joint in places:
                both = f"{self._label(places[joint])!r} and {self._label(column)!r}"
                raise self._error(
                    f"columns {both} are both {channel} of {joint}; valid is one "
                    f"column for each joint, {_HELP}"
                )
            places[joint] = column
        extra = [joint for joint in places if joint not in joints]
        if channel not in _NEEDED and len(extra) == len(places):
            self.aside |= {c.index: "of no joint of the arm" for c in columns}
            return []
        if not {*joints} <= {*places} or (
            extra and places[extra[0]].number is not None
        ):
            raise self._error(
                f"columns of {channel} ({_listed([self._label(c) for c in columns])}): "
                f"{joint_mismatch(tuple(places), joints)}"
            )
        for joint in extra:
            self.aside[places[joint].index] = f"{joint} is no joint of the arm"
        return self._used(channel, [places[joint] for joint in joints], joints)

    def _used(
        self, channel: str, columns: Sequence[Meaning], joints: tuple[str, ...]
    ) -> list[Used]:
        """Columns of a channel with their units; none if they are but currents."""
        source, used = self.map.source(channel), []
        constant = "torque_constant" in source.factors
        for place, (column, joint) in enumerate(zip(columns, joints, strict=True)):
            unit = self._unit(channel, column)
            known = converted(unit or SI[channel][0], channel)
            current = converted(unit, "current") if channel == "tau" else None
            if current and not constant and self._bare_current(column):
                why = f"current in {unit}: a map with a torque_constant is needed"
                self.aside |= {c.index: why for c in columns}
                return []
            known = current or known
            if known is None or constant != bool(current):
                raise self._unit_error(self._label(column), unit, channel)
            factor = known[0] * source.factor(joint, place)
            words = (column.index, self._label(column), channel, joint)
            shown = unit or SI[channel][0]
            used.append(Used(*words, shown, bool(unit), factor, known[1]))
        return used

    def _unit(self, channel: str, column: Meaning) -> str:
        """Unit of a column: the user's, the label's, the file's, the preset's."""
        source = self.map.source(channel)
        stated = [source.unit, column.unit, self.table.unit(column.index)]
        if not self.map.own(channel):  # what a file states is above a preset
            stated = [*stated[1:], source.unit]
        if column.channel == "current" or "torque_constant" in source.factors:
            stated.append("A")
        return next(filter(None, stated), "")

    def _bare_current(self, column: Meaning) -> bool:
        """Whether a current is set aside, not refused as the torque it should be."""
        of_preset = bool(self.map.preset) and not self.map.own("tau")
        return not self.torque or column.channel == "current" or of_preset

    def _unit_error(self, label: str, unit: str, channel: str) -> RecordingError:
        valid = " and ".join(SI[channel])
        more = ", or a current with torque_constant in --map FILE.yaml"
        return self._error(
            f"column {label!r} is in {unit}; valid are {valid} and units that convert "
            f"to them{more if channel == 'tau' else ''}"
        )


def _listed(labels: Sequence[str]) -> str:
    """Labels for a message: a dozen, and how many more."""
    shown = ", ".join(label[:80] for label in labels[:12])
    return shown if len(labels) <= 12 else f"{shown} and {len(labels) - 12} more"
