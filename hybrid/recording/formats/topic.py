"""Decode the messages of one topic of a bag into columns, many at a time."""

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.names import printable
from hybrid.recording.formats.cdr import LayoutError, MessageLayout, Path, layout_of
from hybrid.recording.formats.stream import Stream
from hybrid.recording.table import MOST_COLUMNS, Load, LogTable, check_most

BATCH = 4096  # messages decoded at once
_MOST_BYTES = 16 << 20  # of messages that wait to be decoded
_CONTAINERS = ("interface_values", "values")  # of control_msgs/DynamicJointState
_STAMP: Path = ("header", "stamp", "sec")
_NANO: Path = ("header", "stamp", "nanosec")


class Topic:
    """Messages of a topic of one type (``kind``), which are decoded in batches."""

    def __init__(
        self, name: str, kind: str, types: dict[str, Any], ros2: bool, source: str
    ) -> None:
        self.name, self.kind, self.types = printable(name), printable(kind), types
        self.ros2, self.source, self._place = ros2, source, f"{source}: {self.name}"
        self._waiting: list[tuple[int, bytes]] = []
        self._held = self._size = 0
        self._streams: dict[tuple[str, ...], Stream] = {}
        self._layouts: list[tuple[MessageLayout, dict[str, Path]]] = []
        self._trajectories: list[tuple[int, MessageLayout, NDArray[np.uint8]]] = []

    def add(self, stamp: int, raw: bytes) -> None:
        """Add a message and the recorder's time of it, [ns]."""
        self._waiting.append((stamp, raw))
        self._held += len(raw)
        if len(self._waiting) >= BATCH or self._held > _MOST_BYTES:
            self.decode()

    def decode(self) -> None:
        """Decode the messages that wait."""
        raws = [raw for _, raw in self._waiting]
        stamps = np.array([stamp for stamp, _ in self._waiting], dtype=np.int64)
        self._waiting, self._held = [], 0
        lengths = np.array([len(raw) for raw in raws])
        for length in np.unique(lengths):
            rows = np.flatnonzero(lengths == length)
            joined = b"".join(raws[k] for k in rows)
            messages = np.frombuffer(joined, np.uint8).reshape(len(rows), length)
            while len(rows):
                layout, columns = self._layout(messages[:1])
                same = layout.fits(messages)
                self._append(layout, columns, messages[same], stamps[rows[same]])
                messages, rows = messages[~same], rows[~same]

    def tables(self) -> Iterator[LogTable]:
        """Make a table for each set of columns."""
        if self._trajectories:
            yield self._trajectory_table()
        for stream in self._streams.values():
            clock, own = stream.clock()
            note = "" if own else "time is the recorder's, not the headers'"
            yield self._table(stream.labels, partial(stream.take, clock=clock), note)

    def _table(self, labels: tuple[str, ...], load: Load, note: str = "") -> LogTable:
        names = (f"{self.name}/__time", *labels)
        preset = "joint_state" if self.kind.endswith("/JointState") else ""
        return LogTable(
            self.source, names, load, "ns", kind=f"ROS ({self.kind})",
            name=self.name, preset=preset, note=note,
        )  # fmt: skip

    def _layout(
        self, message: NDArray[np.uint8]
    ) -> tuple[MessageLayout, dict[str, Path]]:
        """Layout of a message, and its columns."""
        for layout, columns in self._layouts:
            if layout.length == message.size and layout.fits(message)[0]:
                return layout, columns
        check_most(self._place, len(self._layouts) + 1, "kinds of messages", 200)
        try:
            layout = layout_of(message.tobytes(), self.kind, self.types, ros2=self.ros2)
        except LayoutError as error:
            raise RecordingError(f"{self._place}: {error}") from error
        trajectory = _is_trajectory(layout)
        if not trajectory:
            count = len(layout.numbers)
            check_most(self._place, count, "numbers in a message", MOST_COLUMNS)
        self._layouts.append((layout, {} if trajectory else self._labels(layout)))
        return self._layouts[-1]

    def _labels(self, layout: MessageLayout) -> dict[str, Path]:
        """Path of each number in a list by its label, with names if there are any."""
        names: dict[Path, dict[int, str]] = {}
        for path, text in layout.texts.items():
            if isinstance(path[-1], int):
                names.setdefault(path[:-2], {})[path[-1]] = text
        return {
            "/".join((self.name, *words)): path
            for path in layout.numbers
            if any(isinstance(part, int) for part in path)
            and (words := _words(path, names)) is not None
        }

    def _append(
        self,
        layout: MessageLayout,
        columns: dict[str, Path],
        messages: NDArray[np.uint8],
        times: NDArray[np.int64],
    ) -> None:
        stamps = np.zeros(len(times), dtype=np.int64)
        if _STAMP in layout.numbers:
            seconds = layout.values(messages, _STAMP).astype(np.int64)
            stamps = seconds * 10**9 + layout.values(messages, _NANO)
        if _is_trajectory(layout):
            starts = np.where(stamps, stamps, times).tolist()
            self._trajectories += [
                (at, layout, messages[k : k + 1].copy()) for k, at in enumerate(starts)
            ]
            return
        labels = tuple(columns)
        stream = self._streams.setdefault(labels, Stream(labels))
        self._size += 8 * len(labels) * len(times)
        check_most(self._place, self._size, "bytes of numbers")
        values = [layout.values(messages, path) for path in columns.values()]
        stream.add(stamps, times, values)

    def _trajectory_table(self) -> LogTable:
        """Points of trajectories as a command; a new trajectory replaces the last."""
        points: list[tuple[int, list[float]]] = []
        joints: tuple[str, ...] = ()
        for start, layout, message in sorted(self._trajectories, key=lambda x: x[0]):
            names = tuple(
                text for path, text in layout.texts.items() if path[0] == "joint_names"
            )
            joints = joints or names
            if names != joints:
                continue
            get = {p: layout.values(message, p)[0] for p in layout.numbers}
            while points and points[-1][0] >= start:
                points.pop()
            count = 1 + max((int(p[1]) for p in get if p[0] == "points"), default=-1)
            for k in range(count):
                after: Path = ("points", k, "time_from_start")
                at = start + int(get[*after, "sec"]) * 10**9
                at += int(get[*after, "nanosec"])
                if not points or at > points[-1][0]:
                    row = [float(get.get(("points", k, "positions", j), np.nan))
                           for j in range(len(joints))]  # fmt: skip
                    points.append((at, row))
        labels = tuple(f"{self.name}/command/positions/{joint}" for joint in joints)
        rows = [row for _, row in points]
        values = np.array(rows, dtype=float).reshape(len(points), len(joints))
        columns = [np.array([at for at, _ in points], dtype=np.int64), *values.T]
        return self._table(labels, lambda used: [{k: columns[k] for k in used}])


def _is_trajectory(layout: MessageLayout) -> bool:
    return any(path[0] == "points" for path in layout.numbers)


def _words(path: Path, names: dict[Path, dict[int, str]]) -> list[str] | None:
    """Words of a label; an entry of a list takes the name at the same index."""
    words: list[str] = []
    for k, part in enumerate(path):
        if isinstance(part, str):
            if part not in _CONTAINERS:
                words.append(part)
            continue
        entries = names.get(path[: k - 1]) or names.get(()) or {}
        if part in entries:
            words.append(entries[part])
        elif k == len(path) - 1:
            words[-1:] = [f"{words[-1] if words else ''}[{part}]"]
        else:
            return None
    return words
