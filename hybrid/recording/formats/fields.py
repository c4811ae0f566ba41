"""Fields of a file -> columns of a table: a matrix or a list has one for each joint."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.names import printable
from hybrid.recording.table import MOST_COLUMNS, LogTable
from hybrid.recording.words import is_time, meaning, split_unit

Spread = tuple[str, str, int | None]  # label, field, and which of the field's columns
Fields = Mapping[str, NDArray[Any]]  # each of shape (N,) or (N, n)
NAMES = ("joints", "joint_names")  # labels of arrays that name the joints
Get = Callable[[Iterable[str]], Fields]

_NAME = re.compile(r"(.*[./]|)(?:joint_)?names?[_.]?\[?(\d+)\]?")
_STATE = re.compile(r"(.*[./]|)(position|velocity|effort)s?[_.]?\[?(\d+)\]?")


def spread_table(
    source: str, spread: Sequence[Spread], get: Get, **more: Any
) -> LogTable:
    """A table of columns of fields, of which only those that are asked for are got."""

    def load(used: tuple[int, ...]) -> list[dict[int, NDArray[Any]]]:
        fields = get(dict.fromkeys(spread[k][1] for k in used))
        return [{k: _column(fields, spread[k], source) for k in used}]

    return LogTable(source, tuple(label for label, _, _ in spread), load, **more)


def _column(fields: Fields, column: Spread, source: str) -> NDArray[Any]:
    _, name, place = column
    if place is None:
        return fields[name]
    if fields[name].shape[1] <= place:
        raise RecordingError(f"{source}: lists of {name!r} of many lengths")
    return fields[name][:, place]


def table_of_arrays(
    arrays: Fields, source: str, *, get: Get | None = None, **more: Any
) -> LogTable:
    """A table of arrays by name, whose matrices have a column for each joint.

    Args:
        arrays: Label -> array; of files that are large, its shape and type alone.
            Text under one of ``NAMES`` names the joints.
        source: File for messages.
        get: Gives the arrays themselves if they are not at hand.
        more: Further fields of the table.

    Raises:
        RecordingError: An array that a channel needs is not numbers in (N,) or (N, n).
    """
    names, held = None, arrays
    got: Get = get or (lambda _: held)
    for key in NAMES:
        if key in arrays and arrays[key].dtype.kind in "SUO":
            arrays = {k: x for k, x in arrays.items() if k != key}
            names = names or tuple(
                x.decode("utf-8", "replace") if isinstance(x, bytes) else str(x).strip()
                for x in got([key])[key].ravel()
            )
    spread: list[Spread] = []
    for label, x in arrays.items():
        wanted = is_time(split_unit(label)[0]) or meaning(label).channel
        if wanted and (x.ndim not in (1, 2) or x.dtype.kind not in "fiu"):
            raise RecordingError(
                f"{source}: {printable(label)} has shape {x.shape} and type {x.dtype}; "
                "valid are numbers, (N,) or (N, n)"
            )
        if is_time(label) or x.ndim != 2:
            spread.append((label, label, None))
        else:
            columns = _labels(label, x.shape[1], names, source)
            spread += [(column, label, k) for k, column in enumerate(columns)]
    return spread_table(source, spread, got, joints=names, **more)


def _labels(
    label: str, count: int, joints: tuple[str, ...] | None, source: str
) -> list[str]:
    """Labels that the columns of an array (N, n) would have in a table."""
    valid = ""
    if count > MOST_COLUMNS:  # an array without rows may state any number
        valid = f"up to {MOST_COLUMNS}"
    elif joints is not None and meaning(label).channel and count != len(joints):
        valid = f"{len(joints)}, one for each of joints {', '.join(joints)}"
    if valid:
        raise RecordingError(
            f"{source}: {printable(label)} has {count} columns; valid are {valid}"
        )
    word, unit = split_unit(label)
    unit = f" [{unit}]" if unit else ""
    if joints is None:
        return [f"{word}[{k + 1}]{unit}" for k in range(count)]
    return [f"{word}_{joint}{unit}" for joint in joints[:count]]


def named_labels(labels: Sequence[str], texts: Mapping[str, str]) -> tuple[str, ...]:
    """Labels of numbered columns with the names that stand in columns beside them.

    ``rostopic echo -p`` writes ``field.name0`` with a joint's name in it, and its
    position as ``field.position0``.

    Args:
        labels: Labels of a table.
        texts: Label -> text in the first row.
    """
    names = {
        match.group(1, 2): text
        for label, text in texts.items()
        if text and (match := _NAME.fullmatch(label))
    }

    def named(label: str) -> str:
        match = _STATE.fullmatch(label) if names else None
        name = names.get(match.group(1, 3)) if match else None
        return f"{match.group(1)}{match.group(2)}/{name}" if match and name else label

    return tuple(map(named, labels))
