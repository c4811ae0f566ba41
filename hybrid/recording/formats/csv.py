"""Read recordings from text files with comma, semicolon or tab, in UTF-8."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import field_table, named_labels
from hybrid.recording.recording import row_words
from hybrid.recording.table import LARGEST_FILE, LogTable

DELIMITERS = (",", ";", "\t")
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_ZONE = re.compile(r"(Z|[+-]\d\d:?\d\d)\s*$")
_WHOLE = re.compile(r"\s*\d{16,19}\s*")  # more digits than a float has
_LONGEST_LINE = 1 << 20  # bytes


@dataclass(frozen=True)
class _Text:
    path: Path
    content: bytes | None  # of a gzipped file
    labels: tuple[str, ...]
    delimiter: str
    decimal_point: str
    first: tuple[str, ...]  # cells of the first row


def read_csv(path: Path) -> list[tuple[LogTable]]:
    """Read a line of column names and one line for each sample.

    Args:
        path: File, gzipped or not, with comma, semicolon or tab between cells. Numbers
            have a decimal point, or a decimal comma if cells have no comma between.
    """
    text = _text(path)
    labels = text.labels
    if labels and not labels[0].strip() and text.first and _DATE.match(text.first[0]):
        labels = ("time", *labels[1:])  # unnamed index of pandas
    labels = named_labels(labels, dict(zip(labels, text.first, strict=False)))
    layout = [(label, str(k), None) for k, label in enumerate(labels)]
    return [(field_table(str(path), layout, partial(_columns, text), kind="CSV"),)]


def _columns(text: _Text, names: Iterable[str]) -> dict[str, NDArray[Any]]:
    """Load columns by the text of their indices from 0."""
    import pyarrow as pa

    first, kinds = dict(enumerate(text.first)), {}
    for k in names:
        cell = first.get(int(k), "")
        whole = pa.int64() if _WHOLE.fullmatch(cell) else pa.float64()
        date = pa.timestamp("ns", tz="UTC" if _ZONE.search(cell) else None)
        kinds[k] = date if _DATE.match(cell) else whole
    try:
        table = _table(text, kinds)
    except pa.ArrowException:
        try:  # again, because several threads do not count rows
            table = _table(text, kinds, use_threads=False)
        except pa.ArrowException as error:
            reason = _explanation(text, str(error))
            raise RecordingError(f"{text.path}: {reason}") from error
    if table.num_rows == 0:
        raise RecordingError(f"{text.path}: no rows below the column names")
    return {k: _numbers(table.column(k)) for k in kinds}


def _table(text: _Text, kinds: dict[str, Any], use_threads: bool = True) -> Any:
    from pyarrow import csv as arrow_csv

    names = [str(k) for k in range(len(text.labels))]
    return arrow_csv.read_csv(
        text.path if text.content is None else io.BytesIO(text.content),
        arrow_csv.ReadOptions(column_names=names, skip_rows=1, use_threads=use_threads),
        arrow_csv.ParseOptions(delimiter=text.delimiter),
        arrow_csv.ConvertOptions(
            column_types=kinds,
            include_columns=list(kinds),
            decimal_point=text.decimal_point,
            null_values=["", "nan", "NaN", "NAN"],
        ),
    )


def _numbers(column: Any) -> NDArray[Any]:
    """Copy a column; pyarrow's own method would import pandas."""
    kind = {"double": np.float64, "int64": np.int64}.get(str(column.type))
    if kind is None or column.null_count:
        return np.asarray(column.to_numpy())
    parts = [
        np.frombuffer(x.buffers()[1], kind)[x.offset : x.offset + len(x)]
        for x in column.chunks
    ]
    return np.concatenate(parts)


def _unpacked(path: Path) -> bytes | None:
    """Content of a gzipped file; None if it is not gzipped."""
    if path.suffix.lower() != ".gz":
        return None
    try:
        with gzip.open(path) as file:
            content = file.read(LARGEST_FILE + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise RecordingError(f"{path}: not a whole gzip file: {error}") from error
    if len(content) > LARGEST_FILE:
        raise RecordingError(f"{path}: unpacks to more than {LARGEST_FILE:.3g} bytes")
    return content


def _text(path: Path) -> _Text:
    """Find labels and delimiter in the first line, the decimal sign in the second."""
    try:
        content = _unpacked(path)
        with path.open("rb") if content is None else io.BytesIO(content) as file:
            lines = file.readline(_LONGEST_LINE), file.readline(_LONGEST_LINE)
    except OSError as error:
        reason = error.strerror or error
        raise RecordingError(f"{path}: cannot be read: {reason}") from error
    header, first = _header(path, lines[0]), lines[1].decode("utf-8", errors="replace")
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
    try:
        cells = tuple(next(csv.reader([first], delimiter=delimiter), ()))
    except csv.Error:  # the reader of all rows reports it
        cells = ()
    comma = delimiter != "," and "," in first and "." not in first
    return _Text(path, content, labels, delimiter, "," if comma else ".", cells)


def _header(path: Path, line: bytes) -> str:
    if line.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in line:
        raise RecordingError(
            f"{path}: not UTF-8 text (UTF-16 or binary); valid is CSV saved as UTF-8"
        )
    try:
        return line.decode("utf-8-sig").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: column names are not UTF-8 (byte "
            f"{error.object[error.start]:#04x}); valid is CSV saved as UTF-8"
        ) from error


def _explanation(text: _Text, error: str) -> str:
    """Explain an error of pyarrow, which counts rows from 1 and includes the header."""
    ragged = r"CSV parse error: Row #(\d+): Expected (\d+) columns, got (\d+)"
    if match := re.match(ragged, error):
        row, valid, found = map(int, match.groups())
        cells = f"{found} cells; valid are {valid}, one for each column name"
        return f"{row_words(row - 2)} has {cells}"
    wrong = r"In CSV column #(\d+): Row #(\d+): .* value '(.*)'"
    if match := re.match(wrong, error):
        label, cell = text.labels[int(match[1])].strip(), match[3].strip()
        return f"{label}, {row_words(int(match[2]) - 2)}: {cell!r} is not a number"
    return f"cannot be read as CSV: {error.splitlines()[0]}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
