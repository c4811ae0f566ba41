"""Assign the columns of a table to channels and joints, and find their units.

The map decides, or else the words of the label. Then joints are matched to the robot's.
Units come from the map, the label, the file, the format or SI, in this order.
"""

from collections.abc import Sequence
from dataclasses import replace

from hybrid.errors import RecordingError
from hybrid.names import printable
from hybrid.recording.joints import match_joints
from hybrid.recording.labels import (
    CHANNEL_WORDS,
    LONGEST,
    TIME,
    Meaning,
    is_time,
    parse_label,
    split_unit,
)
from hybrid.recording.mapping import Mapping, Source, preset_of
from hybrid.recording.reading import Reading, Used
from hybrid.recording.recording import CHANNELS, joint_mismatch, numbered_joints
from hybrid.recording.table import MOST_COLUMNS, LogTable, NoJointsError, check_most
from hybrid.recording.units import SI, converted

_HELP = "or say which column is what with --map FILE.yaml, in Python map="
_REQUIRED = ("q", "tau")


class Assignment:
    """Assignment of the columns of one table to channels and joints."""

    def __init__(
        self,
        table: LogTable,
        joints: tuple[str, ...] | None,
        mapping: Mapping,
        torque: bool,
    ) -> None:
        check_most(table.place, len(table.labels), "columns", MOST_COLUMNS)
        # One character more than the longest label that may have a meaning.
        labels = tuple(printable(x.strip())[: LONGEST + 1] for x in table.labels)
        self.table, self.labels, self.torque = table, labels, torque
        self.map = mapping
        self.preset = preset_of(labels, mapping.preset or table.preset)
        self.joints = joints or mapping.joints or table.joints or ()
        self.unused: dict[int, str] = {}  # column -> reason

    def reading(self, channels: tuple[str, ...] = CHANNELS) -> Reading:
        """Assign the columns of some channels; by default of all."""
        try:
            time = self._time()
        except RecordingError as error:
            if self._columns(-1)["q"]:
                raise
            raise NoJointsError(str(error)) from None
        columns = self._columns(time.index)
        required = _REQUIRED if self.torque else _REQUIRED[:1]
        joints, used = self.joints or self._joints_of(columns), [time]
        for channel in channels:
            assigned = self._assigned(channel, columns[channel], joints)
            if channel in required and not assigned:
                raise self._missing_error(channel)
            used += assigned
        taken, table = {u.index for u in used}, self.table
        aside = [
            (label, self.unused.get(k, "not used"))
            for k, label in enumerate(self.labels)
            if label and k not in taken
        ]
        notes = (table.note,) if table.note else ()
        return Reading(
            table.kind, table.name, self.preset.preset, tuple(used), tuple(aside), notes
        )

    def _label(self, column: Meaning) -> str:
        return self.labels[column.index]

    def _source(self, channel: str) -> Source:
        """Source of a channel by the map, completed by the preset."""
        return self.map.source(channel).over(self.preset.source(channel))

    def _error(self, text: str) -> RecordingError:
        return RecordingError(f"{self.table.place}: {text}")

    def _time(self) -> Used:
        """Find the column of time; its index is -1 if the map gives a rate."""
        source = self._source("time")
        name = source.columns
        if "rate" in source.factors:
            step = 1 / source.factor(("time",), 0)
            return Used(-1, "", "t", "", "s", True, step)
        if name is not None and ("time" in self.map.sources or name in self.labels):
            found = [k for k, x in enumerate(self.labels) if x == name]
            what = f"no column {name!r}"
        else:
            words = [split_unit(label)[0] for label in self.labels]
            exact = [k for k, word in enumerate(words) if word.lower() in TIME]
            found = exact or [k for k, word in enumerate(words) if is_time(word)]
            what = "no column of time" if not found else "more than one column of time"
        if len(found) != 1:
            raise self._error(
                f"{what} among {listed(self.labels)}; valid is one of "
                f"{', '.join(TIME)}, in seconds or with its unit (time_ms), {_HELP}"
            )
        label = self.labels[found[0]]
        of_format = "" if found[0] else self.table.clock_unit
        unit = source.unit or split_unit(label)[1] or of_format
        if unit and converted(unit, "time") is None:
            raise self._unit_error(label, unit, "time")
        return Used(found[0], label, "t", "", unit, bool(unit))

    def _columns(self, time: int) -> dict[str, list[Meaning]]:
        """Find the columns of each channel, by the map or by their labels."""
        labelled = self._by_label(time)
        currents = labelled.get("current", [])
        labelled.setdefault("tau", currents)
        found: dict[str, list[Meaning]] = {}
        for channel in CHANNELS:
            dropped = self.map.source(channel).dropped
            alike = labelled.get(channel, [])
            found[channel] = [] if dropped else self._by_map(channel) or alike
        if found["tau"] is not currents:
            self.unused |= {c.index: "current, beside a torque" for c in currents}
        return found

    def _by_label(self, time: int) -> dict[str, list[Meaning]]:
        known, topic = (*self.joints, *self.map.names), self.map.topic.strip("/")
        meanings = {
            k: parse_label(x, known) for k, x in enumerate(self.labels) if k != time
        }
        # A log of one joint may call its columns just q and tau.
        single = any(m.channel == "q" and not m.joint for m in meanings.values())
        found: dict[str, list[Meaning]] = {}
        for k, m in meanings.items():
            if m.channel and not m.joint and single:
                m = replace(m, number=1, joint="1")
            if not self.labels[k].strip("/").startswith(topic):
                self.unused[k] = f"not of {self.map.topic}"
            elif not m.channel:
                self.unused[k] = m.why
            elif m.joint:
                found.setdefault(m.channel, []).append(replace(m, index=k))
        return found

    def _by_map(self, channel: str) -> list[Meaning]:
        source, where = self._source(channel), f"{channel} of {self.map.origin}"
        if source.columns is None:
            return []
        try:
            found = source.found(self.labels)
            if not found and channel in self.map.sources:
                raise ValueError(f"no column like {source.columns!r}")
        except ValueError as error:
            among = listed(self.labels)
            raise self._error(f"{error} for {where} among {among}") from error
        columns = []
        for k, joint in found.items():
            number = int(joint) if joint.isascii() and joint.isdigit() else None
            unit = split_unit(self.labels[k])[1]
            columns.append(Meaning(channel, joint, number, "", unit, "", k))
        return columns

    def _missing_error(self, channel: str) -> RecordingError:
        word = "positions" if channel == "q" else "torques"
        currents = [self.labels[k] for k, why in self.unused.items()
                    if why.startswith("current")]  # fmt: skip
        if channel == "tau" and currents:
            return self._error(
                f"no torques, but currents ({listed(currents)}); valid is --map "
                "FILE.yaml with tau: {torque_constant: N·m/A, gear_ratio: ...}, each a "
                "number or a list in the order of the joints"
            )
        words = [w for w in CHANNEL_WORDS[channel].split()[:3] if w != "tauj"]
        kind = NoJointsError if channel == "q" else RecordingError
        return kind(
            f"{self.table.place}: no {word} among the columns {listed(self.labels)}; "
            f"valid are {', '.join(f'{w}1 or {w}_<joint>' for w in words)}, {_HELP}"
            f"{'; torque=False reads a log without' if channel == 'tau' else ''}"
        )

    def _joints_of(self, columns: dict[str, list[Meaning]]) -> tuple[str, ...]:
        """Joint names of the file, from the first channel that has names."""
        for channel in _REQUIRED:
            group = self._numbered_or_all(columns[channel])
            names = [c.joint for c in group if c.number is None]
            if names:
                return tuple(dict.fromkeys(self.map.names.get(x, x) for x in names))
        group = self._numbered_or_all(columns["q"])
        return numbered_joints(len({c.joint for c in self._one_group(group)}))

    def _numbered_or_all(self, columns: list[Meaning]) -> list[Meaning]:
        """Numbered columns if there are any: q_motor1 beside q1 is no joint."""
        numbered = [c for c in columns if c.number is not None]
        for c in columns:
            if numbered and c.number is None:
                self.unused[c.index] = "a name beside numbered joints"
        return numbered or columns

    def _one_group(
        self, columns: list[Meaning], joints: tuple[str, ...] = ()
    ) -> list[Meaning]:
        """Columns of the one topic or group that has all joints."""
        groups: dict[str, list[Meaning]] = {}
        for c in columns:
            groups.setdefault(c.space, []).append(c)
        if len(groups) < 2:
            return columns
        good = [s for s, group in groups.items()
                if {*joints} <= {*self._match(group, joints)}]  # fmt: skip
        if "" in good:  # q1 beside motor_position_1
            good = [""]
        if len(good) != 1:
            raise self._error(
                f"columns of {columns[0].channel}, as {self._label(columns[0])!r}, are "
                f"under {listed([*groups])}, {len(good) or 'none'} of them for the "
                "joints; valid is --map FILE.yaml with topic: and the beginning of the "
                "right ones, or which column is what"
            )
        for c in columns:
            if c.space != good[0]:
                self.unused[c.index] = f"not of {good[0] or 'the joints'}"
        return groups[good[0]]

    def _match(self, group: list[Meaning], joints: tuple[str, ...]) -> tuple[str, ...]:
        names = [self.map.names.get(c.joint, c.joint) for c in group]
        return match_joints(names, [c.number for c in group], joints)

    def _assigned(
        self, channel: str, columns: list[Meaning], joints: tuple[str, ...]
    ) -> list[Used]:
        """Columns of one channel in the order of the joints, with their units."""
        if not columns:
            return []
        if not {*joints} <= {*self._match(columns, joints)}:
            columns = self._numbered_or_all(columns)
        columns = self._one_group(columns, joints)
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
        if channel not in _REQUIRED and len(extra) == len(places):
            self.unused |= {c.index: "of no joint of the arm" for c in columns}
            return []
        if not {*joints} <= {*places} or (
            extra and places[extra[0]].number is not None
        ):
            raise self._error(
                f"columns of {channel} ({listed([self._label(c) for c in columns])}): "
                f"{joint_mismatch(tuple(places), joints)}"
            )
        for joint in extra:
            self.unused[places[joint].index] = f"{joint} is no joint of the arm"
        return self._with_units(channel, [places[joint] for joint in joints], joints)

    def _with_units(
        self, channel: str, columns: Sequence[Meaning], joints: tuple[str, ...]
    ) -> list[Used]:
        """Columns of a channel with their units; none for currents without a factor."""
        own, preset = self.map.source(channel), self.preset.source(channel)
        source, used = own.over(preset), list[Used]()
        constant = "torque_constant" in source.factors
        for place, (column, joint) in enumerate(zip(columns, joints, strict=True)):
            # That of the user, the label, the file or the preset, in this order.
            unit = own.unit or column.unit or preset.unit
            if not unit and (constant or column.channel == "current"):
                unit = "A"
            known = converted(unit or SI[channel][0], channel)
            current = converted(unit, "current") if channel == "tau" else None
            # One that the user did not call a torque is ignored, and not refused.
            by_preset = self.preset.preset and "tau" not in self.map.sources
            ignored = not self.torque or column.channel == "current" or by_preset
            if current and not constant and ignored:
                why = f"current in {unit}: a map with a torque_constant is needed"
                self.unused |= {c.index: why for c in columns}
                return []
            known = current or known
            if known is None or constant != bool(current):
                raise self._unit_error(self._label(column), unit, channel)
            factor = known[0] * source.factor(joints, place)
            words = (column.index, self._label(column), channel, joint)
            shown = unit or SI[channel][0]
            used.append(Used(*words, shown, bool(unit), factor, known[1]))
        return used

    def _unit_error(self, label: str, unit: str, channel: str) -> RecordingError:
        valid = " and ".join(SI[channel])
        more = ", or a current with torque_constant in --map FILE.yaml"
        return self._error(
            f"column {label!r} is in {unit}; valid are {valid} and units that convert "
            f"to them{more if channel == 'tau' else ''}"
        )


def listed(labels: Sequence[str]) -> str:
    """List at most twelve labels for a message, and count the others."""
    shown = ", ".join(label[:80] for label in labels[:12])
    return shown if len(labels) <= 12 else f"{shown} and {len(labels) - 12} more"
