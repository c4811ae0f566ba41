"""Turn the fields of a file into columns: a matrix has one column for each joint."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from hybrid.arrays import AnyArray
from hybrid.errors import RecordingError
from hybrid.names import printable
from hybrid.recording.labels import is_time, parse_label, split_unit
from hybrid.recording.table import MOST_COLUMNS, LogTable, check_most, check_numbers

Fields = Mapping[str, AnyArray]  # each of shape (N,) or (N, n)
NAMES = ("joints", "joint_names")  # labels of arrays that name the joints
Get = Callable[[Iterable[str]], Fields]

_NAME = re.compile(r"(.*[./]|)(?:joint_)?names?[_.]?\[?(\d+)\]?")
_STATE = re.compile(r"(.*[./]|)(position|velocity|effort)s?[_.]?\[?(\d+)\]?")


def table_of_arrays(
    arrays: Fields, source: str, *, get: Get | None = None, **more: Any
) -> LogTable:
    """Make a table of arrays by label; a matrix has a column for each joint.

    Text under one of ``NAMES`` names the joints. Where ``get`` loads the arrays, those
    given need the right shape and type only; ``more`` are fields of the table.
    """
    load: Get = get or (lambda _: arrays)
    named = [k for k in NAMES if k in arrays and arrays[k].dtype.kind in "SUO"]
    names = _texts(load(named)[named[0]]) if named else None
    layout: list[tuple[str, str, Any]] = []  # label, array, index of the column in it
    for label, x in arrays.items():
        if label in named:
            continue
        timed = is_time(split_unit(label)[0])
        if timed or parse_label(label).channel:
            check_numbers(x, label, source, timed=timed, most_axes=2)
        if is_time(label) or x.ndim != 2:
            layout.append((label, label, ()))
        else:
            columns = _labels(label, x.shape[1], names, source)
            layout += [(name, label, (..., k)) for k, name in enumerate(columns)]

    def blocks(used: tuple[int, ...]) -> list[dict[int, AnyArray]]:
        fields = load(dict.fromkeys(layout[k][1] for k in used))
        return [{k: fields[layout[k][1]][layout[k][2]] for k in used}]

    labels = tuple(label for label, _, _ in layout)
    return LogTable(source, labels, blocks, joints=names, **more)


def _texts(x: AnyArray) -> tuple[str, ...]:
    return tuple(
        v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v).strip()
        for v in x.ravel()
    )


def _labels(
    label: str, count: int, joints: tuple[str, ...] | None, source: str
) -> list[str]:
    """Labels of the columns of an array (N, n)."""
    where = f"{source}: {printable(label)}"
    # An array without rows may state any shape.
    check_most(where, count, "columns", MOST_COLUMNS)
    if joints is not None and parse_label(label).channel and count != len(joints):
        raise RecordingError(
            f"{where}: {count} columns; valid are {len(joints)}, one for each of "
            f"joints {', '.join(joints)}"
        )
    word, unit = split_unit(label)
    unit = f" [{unit}]" if unit else ""
    if joints is None:
        return [f"{word}[{k + 1}]{unit}" for k in range(count)]
    return [f"{word}_{joint}{unit}" for joint in joints[:count]]


def named_labels(labels: Sequence[str], texts: Mapping[str, str]) -> tuple[str, ...]:
    """Replace numbers in labels by names that other columns hold.

    ``rostopic echo -p`` writes the name of a joint as the value of ``field.name0``, and
    its position as ``field.position0``; ``texts`` are those of the first row, by label.
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
