"""The names that columns of a log may have, and where each column belongs."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording.recording import (
    CHANNELS,
    joint_mismatch,
    numbered_joints,
)

LARGEST_FILE = 4 << 30  # bytes: an hour at 1 kHz of 50 joints is less
TIME = ("t", "time", "timestamp", "time_s", "t_s")
WORDS = {
    "q": ("q", "pos", "position"),
    "tau": ("tau", "torque", "effort"),
    "v": ("v", "dq", "qd", "vel", "velocity", "speed"),
    "command": ("command", "cmd", "qref", "q_ref", "qcmd", "q_cmd", "reference"),
    "temperature": ("temperature", "temp"),
}
_NEEDED = ("q", "tau")
_CHANNEL = {word: channel for channel, words in WORDS.items() for word in words}
_LONGEST_FIRST = "|".join(sorted(map(re.escape, _CHANNEL), key=len, reverse=True))
_NUMBERED = re.compile(rf"({_LONGEST_FIRST})[_. ]?\[?(\d+)\]?", re.IGNORECASE)
_NAMED = re.compile(rf"({_LONGEST_FIRST})(?:[_. ](.+?)|\[(.+?)\])", re.IGNORECASE)
_UNIT = re.compile(r"\s*(?:[\[(]([^\[\]()]+)[\])]|_(deg|[mun]s))$")
_RIGHT = re.compile(r"s|sec|seconds|(rad|m)(/s)?|N|N[ .·*]?m|(°|deg)?C")
_WRONG = re.compile(r"([Dd]eg|[Dd]egrees?|°|mm)(/s)?|rpm|[mµun]s|m?A|mN[ .·*]?m")


@dataclass(frozen=True)
class Layout:
    """Which column of a table holds what.

    Attributes:
        time: Index of the column of time.
        channels: Indices of the columns of each channel, in the order of the joints.
        joints: Joint names.
    """

    time: int
    channels: dict[str, tuple[int, ...]]
    joints: tuple[str, ...]

    @property
    def used(self) -> tuple[int, ...]:
        """Indices of all columns that are read."""
        return (self.time, *(k for column in self.channels.values() for k in column))


@dataclass(frozen=True)
class _Column:
    index: int
    label: str
    channel: str
    number: int | None  # from the name: 1 is the first, unless the file counts from 0
    joint: str | None


def match_columns(
    labels: Sequence[str],
    *,
    joints: tuple[str, ...] | None,
    source: str,
    torque: bool = True,
) -> Layout:
    """Find time and the joint channels among the labels of a table.

    A label is a word of ``WORDS`` followed by a joint number (``q1``, ``q_1``) or
    a joint name (``q_elbow``; the ending ``_joint`` of a name may be left out).
    Numbers are taken in order, from 1 or from 0; names are put in the order of
    ``joints``. Without it, names keep the order of their first channel.

    Args:
        labels: Column labels.
        joints: Joint names of the robot, base to tip; None if not known.
        source: File name for messages.
        torque: Whether torques must be there.

    Raises:
        RecordingError: Time, positions or torques are missing, a label is repeated, a
            unit is not SI, or the joints are not those of the robot.

    Warns:
        HybridWarning: Columns were ignored; they are listed.
    """
    labels = [label.strip() for label in labels]
    words = [_split_unit(label)[0] for label in labels]
    time = [k for k, word in enumerate(words) if word.lower() in TIME]
    if len(time) != 1:
        what = "no column of time" if not time else "more than one column of time"
        raise RecordingError(
            f"{source}: {what} among {_listed(labels)}; valid is one of "
            f"{', '.join(TIME)}, in seconds"
        )
    columns = _joint_columns(words)
    for channel in ("q", "tau") if torque else ("q",):
        if not any(column.channel == channel for column in columns):
            word = "positions" if channel == "q" else "torques"
            raise RecordingError(
                f"{source}: no {word} among the columns {_listed(labels)}; valid are "
                f"{', '.join(f'{w}1 or {w}_<joint>' for w in WORDS[channel])}"
            )
    if joints is None:
        joints = _joints_of(columns)
    # dq_cmd1 is no speed of a joint cmd1.
    known = {c.channel for c in columns if _joint_of(c, joints, start=1) in joints}
    columns = [c for c in columns if c.channel in known.union(_NEEDED)]
    channels = {
        channel: _placed([c for c in columns if c.channel == channel], joints, source)
        for channel in CHANNELS
        if any(c.channel == channel for c in columns)
    }
    layout = Layout(time=time[0], channels=channels, joints=joints)
    _check_units(layout, labels, source)
    ignored = [x for k, x in enumerate(labels) if x and k not in layout.used]
    if ignored:
        warnings.warn(
            f"{source}: ignored columns: {', '.join(ignored)}",
            HybridWarning,
            stacklevel=2,
        )
    return layout


def word_channel(label: str) -> str | None:
    """The channel that a bare word such as ``effort`` stands for, or None."""
    return _CHANNEL.get(label.lower())


def _split_unit(label: str) -> tuple[str, str]:
    """A label without its unit, and the unit; other brackets hold a joint."""
    match = _UNIT.search(label)
    unit = (match.group(1) or match.group(2)).strip() if match else ""
    if match and (_RIGHT.fullmatch(unit) or _WRONG.fullmatch(unit)):
        return label[: match.start()], unit
    return label, ""


def _check_units(layout: Layout, labels: Sequence[str], source: str) -> None:
    for label in (labels[k] for k in layout.used):
        unit = _split_unit(label)[1]
        if _WRONG.fullmatch(unit):
            raise RecordingError(
                f"{source}: column {label!r} is in {unit}; valid are s, rad, rad/s and "
                "N·m (m, m/s and N for a linear joint)"
            )


def _joint_columns(labels: Sequence[str]) -> list[_Column]:
    found = []
    # Of an arm with one joint, columns may be called just q and tau.
    single = any(word_channel(label) == "q" for label in labels)
    for index, label in enumerate(labels):
        if single and (channel := word_channel(label)):
            found.append(_Column(index, label, channel, 1, None))
            continue
        if match := _NUMBERED.fullmatch(label):
            number, joint = int(match.group(2)), None
        elif match := _NAMED.fullmatch(label):
            number, joint = None, match.group(2) or match.group(3)
        else:
            continue
        channel = _CHANNEL[match.group(1).lower()]
        found.append(_Column(index, label, channel, number, joint))
    numbered = {column.channel for column in found if column.number is not None}
    # q1..q6 beside q_motor1..q_motor6: the numbered ones are the joints
    return [c for c in found if c.joint is None or c.channel not in numbered]


def _joints_of(columns: list[_Column]) -> tuple[str, ...]:
    for channel in _NEEDED:
        names = [c.joint for c in columns if c.channel == channel and c.joint]
        if names:
            return tuple(dict.fromkeys(names))
    return numbered_joints(sum(column.channel == "q" for column in columns))


def _placed(
    columns: list[_Column], joints: tuple[str, ...], source: str
) -> tuple[int, ...]:
    """Indices of the columns of one channel in the order of the joints."""
    start = min((c.number for c in columns if c.number is not None), default=1)
    places: dict[str, _Column] = {}
    for column in columns:
        joint = _joint_of(column, joints, start=min(start, 1))
        if joint in places:
            raise RecordingError(
                f"{source}: columns {places[joint].label!r} and {column.label!r} are "
                f"both {column.channel} of {joint}; valid is one column for each joint"
            )
        places[joint] = column
    if places.keys() != set(joints):
        raise RecordingError(
            f"{source}: columns of {columns[0].channel} "
            f"({_listed([c.label for c in columns])}): "
            f"{joint_mismatch(tuple(places), joints)}"
        )
    return tuple(places[joint].index for joint in joints)


def _joint_of(column: _Column, joints: tuple[str, ...], *, start: int) -> str:
    if column.joint is None:
        assert column.number is not None
        if str(column.number) in joints:
            return str(column.number)
        place = column.number - start
        return joints[place] if place < len(joints) else f"number {column.number}"
    name = column.joint.lower()
    for joint in joints:
        if joint.lower() == name:
            return joint
    short = [joint for joint in joints if joint.lower().removesuffix("_joint") == name]
    return short[0] if len(short) == 1 else column.joint


def _listed(labels: Sequence[str]) -> str:
    shown = ", ".join(labels[:12])
    return shown if len(labels) <= 12 else f"{shown} and {len(labels) - 12} more"
