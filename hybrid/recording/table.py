"""What a reader of a format yields: named columns that are loaded when needed."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.recording import Recording, numbered_joints

LARGEST_FILE = 4 << 30  # bytes: an hour at 1 kHz of 50 joints is less
MOST_COLUMNS = 20_000  # of a table: more are no log of an arm

_NAME = re.compile(r"(.*[./]|)(?:joint_)?names?[_.]?\[?(\d+)\]?")
_STATE = re.compile(r"(.*[./]|)(position|velocity|effort)s?[_.]?\[?(\d+)\]?")

Load = Callable[[tuple[int, ...]], list[dict[int, NDArray[Any]]]]


@dataclass(frozen=True)
class LogTable:
    """Named columns on one clock.

    Attributes:
        source: File or folder that it comes from.
        labels: Label of each column, as the file has it.
        load: Gives the samples of columns by their indices, in blocks of rows, one
            after the other: index -> shape (N,). A stream gives its blocks away, so
            that a log is never held twice: the numbers can be had once.
        units: Unit that the file states for each column apart from its label; empty
            strings where it states none, or no strings at all.
        joints: Joint names of the file, for columns that are only numbered.
        kind: Name of the format.
        name: Which recording or topic of the source it is; empty if there is one.
        preset: Name of the preset that the format itself stands for.
        home: What warnings name instead of the source: the dataset of an episode, so
            that a thousand episodes are warned of once.
        note: What the reader decided, in one line; empty if nothing.
    """

    source: str
    labels: tuple[str, ...]
    load: Load
    units: tuple[str, ...] = ()
    joints: tuple[str, ...] | None = None
    kind: str = ""
    name: str = ""
    preset: str = ""
    home: str = ""
    note: str = ""

    @property
    def place(self) -> str:
        """Words for messages: the source, and which part of it."""
        return f"{self.source} ({self.name})" if self.name else self.source

    def unit(self, index: int) -> str:
        """Unit that the file states for a column apart from its label."""
        return self.units[index] if self.units else ""


def table_of_arrays(
    columns: dict[str, NDArray[Any]], source: str, **more: Any
) -> LogTable:
    """A table of columns at hand.

    Args:
        columns: Label -> samples, each of shape (N,).
        source: File for messages.
        more: Further fields of the table.
    """
    values = list(columns.values())
    return LogTable(
        source, tuple(columns), lambda used: [{k: values[k] for k in used}], **more
    )


def named_labels(labels: Sequence[str], texts: Mapping[str, str]) -> tuple[str, ...]:
    """Labels of numbered columns with the names that stand in columns beside them.

    ``rostopic echo -p`` writes ``field.name0`` with a joint's name in it, and its
    position as ``field.position0``.

    Args:
        labels: Labels of a table.
        texts: Label -> text in the first row.
    """
    names = {
        (match.group(1), match.group(2)): text
        for label, text in texts.items()
        if text and (match := _NAME.fullmatch(label))
    }

    def named(label: str) -> str:
        match = _STATE.fullmatch(label)
        name = names.get((match.group(1), match.group(3))) if match else None
        return f"{match.group(1)}{match.group(2)}/{name}" if match and name else label

    return tuple(map(named, labels)) if names else tuple(labels)


def labels_of(recording: Recording) -> dict[str, NDArray[np.float64]]:
    """Columns of a recording, under labels that the readers understand.

    Args:
        recording: Joint log.

    Returns:
        Label -> samples, shape (N,): ``time``, then ``q1`` ... or ``q_elbow`` ...
    """
    numbered = recording.joints == numbered_joints(recording.size)
    columns = {"time": recording.t}
    for channel, x in recording.channels.items():
        for k, joint in enumerate(recording.joints):
            columns[f"{channel}{k + 1}" if numbered else f"{channel}_{joint}"] = x[:, k]
    return columns


@contextmanager
def whole(source: object, kind: str) -> Iterator[None]:
    """Turn whatever a library raises of a damaged file into one line.

    Args:
        source: File for the message.
        kind: What it should be.

    Raises:
        RecordingError: The block raised an error; those of this package stay as is.
    """
    try:
        yield
    except RecordingError:
        raise
    except Exception as error:  # a damaged file ends in any error of any library
        reason = (str(error).splitlines() or [type(error).__name__])[0][:200]
        raise RecordingError(
            f"{source}: not a whole {kind} (truncated?): {reason}"
        ) from error


class NoJointsError(RecordingError):
    """A valid file without any joint channel; the message says what it has."""
