"""Recordings as text: comma, semicolon or tab, in UTF-8."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.recording import row_words
from hybrid.recording.table import LARGEST_FILE, LogTable, named_labels

DELIMITERS = (",", ";", "\t")


@dataclass(frozen=True)
class _Dialect:
    labels: tuple[str, ...]
    delimiter: str
    decimal_point: str
    first: tuple[str, ...] = ()  # cells of the first row


def read_csv(path: Path) -> list[tuple[LogTable]]:
    """A line of column names and one line for each sample.

    Args:
        path: File, gzipped or not; comma, semicolon or tab between cells, decimal point
            or, between semicolons or tabs, decimal comma.

    Raises:
        RecordingError: The file is empty, not UTF-8, has a ragged row or a cell that
            is no number; the message names column and row.
    """
    dialect = _dialect_of(path)
    labels = dialect.labels
    if labels and not labels[0].strip() and _is_date(dialect.first[:1]):
        labels = ("time", *labels[1:])  # the index of pandas, which has no name
    texts = dict(zip(labels, dialect.first, strict=False))
    labels = named_labels(labels, texts)
    return [
        (LogTable(str(path), labels, lambda used: _read_columns(path, dialect, used),
               kind="CSV"),)
    ]  # fmt: skip


def _read_columns(
    path: Path, dialect: _Dialect, used: tuple[int, ...]
) -> list[dict[int, NDArray[Any]]]:
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in range(len(dialect.labels))]
    kinds = {k: _kind(dialect.first[k : k + 1]) for k in used}
    types = {"date": pa.timestamp("ns"), "whole": pa.int64(), "real": pa.float64()}
    try:
        table = arrow_csv.read_csv(
            _inflated(path),
            arrow_csv.ReadOptions(column_names=names, skip_rows=1),
            arrow_csv.ParseOptions(delimiter=dialect.delimiter),
            arrow_csv.ConvertOptions(
                column_types={str(k): types[kinds[k]] for k in used},
                include_columns=[str(k) for k in used],
                decimal_point=dialect.decimal_point,
                null_values=["", "nan", "NaN", "NAN"],
            ),
        )
    except pa.ArrowException as error:
        raise _explained(path, dialect, used, error) from error
    if table.num_rows == 0:
        raise RecordingError(f"{path}: no rows below the column names")
    return [{k: _numbers(table.column(str(k))) for k in used}]


def _numbers(column: Any) -> NDArray[Any]:
    """A column as it lies in memory: pyarrow's own way loads pandas for that."""
    kind = {"double": np.float64, "int64": np.int64}.get(str(column.type))
    if kind is None or column.null_count:
        return np.asarray(column.to_numpy())
    parts = [
        np.frombuffer(x.buffers()[1], kind)[x.offset : x.offset + len(x)]
        for x in column.chunks
    ]
    return np.concatenate(parts)


def _opener(path: Path) -> Any:
    return gzip.open if path.suffix.lower() == ".gz" else open


def _inflated(path: Path) -> Any:
    """The file, or what is in it if it is gzipped, up to the size of any log."""
    if path.suffix.lower() != ".gz":
        return path
    try:
        with gzip.open(path) as file:
            content = file.read(LARGEST_FILE + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise RecordingError(f"{path}: not a whole gzip file: {error}") from error
    if len(content) > LARGEST_FILE:
        raise RecordingError(f"{path}: unpacks to more than {LARGEST_FILE:.3g} bytes")
    return io.BytesIO(content)


def _kind(cells: tuple[str, ...]) -> str:
    """How to hold a column: digits beyond a float's, dates, or real numbers."""
    if _is_date(cells):
        return "date"
    return "whole" if cells and re.fullmatch(r"\d{16,19}", cells[0].strip()) else "real"


def _is_date(cells: tuple[str, ...]) -> bool:
    return bool(cells and re.match(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d", cells[0].strip()))


def _dialect_of(path: Path) -> _Dialect:
    """Labels and delimiter from the first line, decimal sign from the second."""
    header, first = _first_lines(path)
    if not header.strip():
        empty = "is empty" if path.stat().st_size == 0 else "has an empty first line"
        raise RecordingError(f"{path}: {empty}; valid is a first line of column names")
    delimiter = max(DELIMITERS, key=header.count)
    if delimiter not in header and " " in header.strip():
        delimiter = " "  # as UR's recorder writes
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
    cells = tuple(next(csv.reader([first], delimiter=delimiter), ()))
    comma = delimiter != "," and "," in first and "." not in first
    return _Dialect(labels, delimiter, "," if comma else ".", cells)


def _first_lines(path: Path) -> tuple[str, str]:
    try:
        with _opener(path)(path, "rb") as file:
            header, first = (file.readline(1 << 20) for _ in range(2))
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise RecordingError(f"{path}: cannot be read: {reason}") from error
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
            if (
                cell
                and not _is_date((cell,))
                and not _is_number(cell.replace(dialect.decimal_point, "."))
            ):
                return RecordingError(
                    f"{path}: {dialect.labels[k].strip()}, {row_words(row)}: {cell!r} "
                    "is not a number"
                )
    reason = str(error).splitlines()[0]
    return RecordingError(f"{path}: cannot be read as CSV: {reason}")


def _cells(path: Path, dialect: _Dialect) -> Iterator[list[str]]:
    with _opener(path)(
        path, "rt", encoding="utf-8-sig", errors="replace", newline=""
    ) as file:
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
