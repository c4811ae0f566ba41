"""Recordings as text: comma, semicolon or tab, in UTF-8."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.columns import match_columns
from hybrid.recording.recording import Recording, row_words
from hybrid.recording.table import labels_of, recording_from_layout

Array = NDArray[np.float64]

DELIMITERS = (",", ";", "\t")


@dataclass(frozen=True)
class _Dialect:
    labels: tuple[str, ...]
    delimiter: str
    decimal_point: str


def read_csv(
    path: Path, *, joints: tuple[str, ...] | None = None, torque: bool = True
) -> Recording:
    """Read a log with one line of column names and one line for each sample.

    Args:
        path: File; comma, semicolon or tab between cells, decimal point or, between
            semicolons or tabs, decimal comma.
        joints: Joint names of the robot, base to tip; None if not known.
        torque: Refuse a log without torques.

    Raises:
        RecordingError: The file is empty, not UTF-8, has a ragged row or a cell that
            is no number; the message names column and row.

    Warns:
        HybridWarning: Columns were ignored.
    """
    source = str(path)
    dialect = _dialect_of(path)
    layout = match_columns(dialect.labels, joints=joints, source=source, torque=torque)
    columns = _read_columns(path, dialect, layout.used)
    return recording_from_layout(layout, columns.__getitem__, source=source)


def write_csv(recording: Recording, path: Path) -> None:
    """Write a log so that every number reads back to the last bit."""
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    options = arrow_csv.WriteOptions(quoting_style="needed")
    arrow_csv.write_csv(pa.table(labels_of(recording)), path, options)


def _read_columns(
    path: Path, dialect: _Dialect, used: tuple[int, ...]
) -> dict[int, Array]:
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in range(len(dialect.labels))]
    try:
        table = arrow_csv.read_csv(
            path,
            arrow_csv.ReadOptions(column_names=names, skip_rows=1),
            arrow_csv.ParseOptions(delimiter=dialect.delimiter),
            arrow_csv.ConvertOptions(
                column_types={str(k): pa.float64() for k in used},
                include_columns=[str(k) for k in used],
                decimal_point=dialect.decimal_point,
                null_values=["", "nan", "NaN", "NAN"],
            ),
        )
    except pa.ArrowException as error:
        raise _explained(path, dialect, used, error) from error
    if table.num_rows == 0:
        raise RecordingError(f"{path}: no rows below the column names")
    return {k: table.column(str(k)).to_numpy().astype(np.float64) for k in used}


def _dialect_of(path: Path) -> _Dialect:
    """Labels and delimiter from the first line, decimal sign from the second."""
    header, first = _first_lines(path)
    if not header.strip():
        empty = "is empty" if path.stat().st_size == 0 else "has an empty first line"
        raise RecordingError(f"{path}: {empty}; valid is a first line of column names")
    delimiter = max(DELIMITERS, key=header.count)
    try:
        line = csv.reader([header], delimiter=delimiter, skipinitialspace=True)
        labels = tuple(next(line))
    except csv.Error as error:
        raise RecordingError(f"{path}: first line of column names: {error}") from error
    if all(_is_number(label) for label in labels if label.strip()):
        raise RecordingError(
            f"{path}: the first line holds numbers; valid are column names such as "
            "time, q1, tau1"
        )
    comma = delimiter != "," and "," in first and "." not in first
    return _Dialect(labels, delimiter, "," if comma else ".")


def _first_lines(path: Path) -> tuple[str, str]:
    try:
        with path.open("rb") as file:
            header, first = (file.readline(1 << 20) for _ in range(2))
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    if header.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in header:
        raise RecordingError(
            f"{path}: not UTF-8 text (UTF-16 or binary); valid is CSV saved as UTF-8"
        )
    try:
        words = header.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: column names are not UTF-8 (byte "
            f"{error.object[error.start]:#04x}); valid is CSV saved as UTF-8"
        ) from error
    return words, first.decode("utf-8", errors="replace")


def _explained(
    path: Path, dialect: _Dialect, used: tuple[int, ...], error: Exception
) -> RecordingError:
    """The reader's error with file, column and row, found by reading line by line."""
    for row, cells in enumerate(_cells(path, dialect)):
        if len(cells) != len(dialect.labels):
            return RecordingError(
                f"{path}: {row_words(row)} has {len(cells)} cells; valid are "
                f"{len(dialect.labels)}, one for each column name"
            )
        for k in used:
            cell = cells[k].strip()
            if cell and not _is_number(cell.replace(dialect.decimal_point, ".")):
                return RecordingError(
                    f"{path}: {dialect.labels[k].strip()}, {row_words(row)}: {cell!r} "
                    "is not a number"
                )
    reason = str(error).splitlines()[0]
    return RecordingError(f"{path}: cannot be read as CSV: {reason}")


def _cells(path: Path, dialect: _Dialect) -> Iterator[list[str]]:
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        reader = csv.reader(file, delimiter=dialect.delimiter)
        try:
            next(reader)
            yield from (cells for cells in reader if cells)
        except csv.Error:  # the reason of the fast reader is all there is to tell
            return


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
