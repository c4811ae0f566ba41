"""Read recordings from text files with comma, semicolon or tab, in UTF-8."""

import csv
import gzip
import re
import warnings
from codecs import BOM_UTF8
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from io import BytesIO, TextIOWrapper
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import named_labels
from hybrid.recording.recording import row_words
from hybrid.recording.table import (
    LARGEST_FILE,
    LogTable,
    as_recording_error,
    check_most,
)
from hybrid.recording.units import fits

DELIMITERS = (",", ";", "\t")
_DATE = re.compile(r"\s*\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
_DATES = "M8[ns]"
_ZONE = re.compile(r":\d\d(\.\d*)?\s*(Z|[+-]\d\d:?\d\d)\s*$")
_WHOLE = re.compile(r"\s*\d{16,19}\s*")  # more digits than a float has
_LONGEST_LINE = 1 << 20  # bytes
_MOST_COMMENTS = 1000  # lines


@dataclass(frozen=True)
class _Text:
    path: Path
    open: Callable[[], BinaryIO]  # the whole text, from its start
    labels: tuple[str, ...]
    delimiter: str
    decimal_point: str
    first: tuple[str, ...]  # cells of the first row
    above: int  # lines above it


def read_csv(path: Path) -> list[tuple[LogTable]]:
    """Read a line of column names and one line for each sample, gzipped or not.

    Comments, which begin with ``#``, may stand above, and the names in the last of
    them; a line of units may stand below. Cells have comma, semicolon or tab between.
    Numbers have a decimal point, or a decimal comma if cells have no comma between.
    """
    text = _text(path)
    labels = text.labels
    if labels and not labels[0].strip() and text.first and _DATE.match(text.first[0]):
        labels = ("time", *labels[1:])  # unnamed index of pandas
    labels = named_labels(labels, dict(zip(labels, text.first, strict=False)))
    return [(LogTable(str(path), labels, partial(_blocks, text), kind="CSV"),)]


def _blocks(text: _Text, used: tuple[int, ...]) -> list[dict[int, AnyArray]]:
    """Load columns by their indices, in one block."""
    kinds = {k: _kind(text.first[k] if k < len(text.first) else "") for k in used}
    columns = _by_arrow(text, kinds)
    if columns is None:
        try:
            rows = _rows(text, kinds)
        except ValueError as error:
            reason = _explanation(text, str(error))
            raise RecordingError(f"{text.path}: {reason}") from error
        columns = {k: rows[str(k)] for k in used}
    if used and not len(columns[used[0]]):
        raise RecordingError(f"{text.path}: no rows below the column names")
    return [columns]


def _kind(cell: str) -> str:
    """Type of a column by its first cell."""
    if _DATE.match(cell):
        return _DATES
    return "i8" if _WHOLE.fullmatch(cell) else "f8"


def _by_arrow(text: _Text, kinds: Mapping[int, str]) -> dict[int, AnyArray] | None:
    """Load all rows five times as fast; None without pyarrow, or if it refuses one."""
    try:
        from pyarrow import ArrowInvalid, from_numpy_dtype, timestamp
        from pyarrow.csv import ConvertOptions, ParseOptions, ReadOptions, read_csv
    except ImportError:
        return None

    labels = [str(k) for k in range(len(text.labels))]
    types = {str(k): from_numpy_dtype(np.dtype(kind)) for k, kind in kinds.items()}
    for k, kind in kinds.items():
        if kind == _DATES and _ZONE.search(text.first[k]):
            types[str(k)] = timestamp("ns", "UTC")
    read = ReadOptions(use_threads=False, skip_rows=text.above, column_names=labels)
    convert = ConvertOptions(
        column_types=types,
        include_columns=list(types),
        null_values=[""],
        decimal_point=text.decimal_point,
    )
    try:
        with text.open() as raw:
            table = read_csv(raw, read, ParseOptions(delimiter=text.delimiter), convert)
    except ArrowInvalid:
        return None
    if any(kinds[int(k)] != "f8" and table[k].null_count for k in types):
        return None
    if "i8" in kinds.values():
        with text.open() as lines:
            rows = islice(lines, text.above, None)
            if any(b"0x" in row or b"0X" in row for row in rows):
                return None  # Arrow reads hexadecimals as whole numbers
    return {
        k: np.concatenate(
            [np.empty(0, kind), *(_numbers(x, kind) for x in table[str(k)].chunks)]
        )
        for k, kind in kinds.items()
    }


def _numbers(chunk: Any, kind: str) -> AnyArray:
    """Numbers of a chunk of Arrow; nulls are NaN."""
    if chunk.null_count:
        return np.asarray(chunk.to_numpy(zero_copy_only=False))
    # ``to_numpy`` would import pandas, which takes as long as a minute of a log.
    _, values = chunk.buffers()
    return np.frombuffer(values, kind, len(chunk), 8 * chunk.offset)


def _rows(text: _Text, kinds: Mapping[int, str]) -> AnyArray:
    """Load all rows by NumPy; ``ValueError`` has its words on the first bad one."""
    try:
        return _loaded(text, kinds, {_DATES: _date})
    except ValueError:  # again, with blank cells as NaN
        return _loaded(text, kinds, {_DATES: _date, "f8": _number})


def _loaded(
    text: _Text, kinds: Mapping[int, str], parsers: Mapping[str, Callable[[str], Any]]
) -> AnyArray:
    layout = [(str(k), kinds.get(k, "U1")) for k in range(len(text.labels))]
    with TextIOWrapper(text.open(), "utf-8", "replace", newline="") as lines:
        comma = text.decimal_point == ","
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's on no rows, and on time zones
            return np.loadtxt(
                (x.replace(",", ".") for x in lines) if comma else lines,
                layout,
                comments=None,
                delimiter=text.delimiter,
                skiprows=text.above,
                converters={k: parsers[x] for k, x in kinds.items() if x in parsers},
                ndmin=1,
                quotechar='"',
            )


def _number(cell: str) -> float:
    """Number of a cell; a blank one is NaN."""
    if "_" in cell:
        raise ValueError
    return float(cell.strip() or "nan")


def _date(cell: str) -> np.datetime64:
    """Time of a cell, in UTC if it states a zone."""
    return np.datetime64(cell.strip(), "ns")


def _opener(path: Path) -> Callable[[], BinaryIO]:
    """What opens the text of a file; a gzipped one is unpacked once."""
    if path.suffix.lower() != ".gz":
        return lambda: path.open("rb")
    with as_recording_error(path, "gzip file"), gzip.open(path) as file:
        content = file.read(LARGEST_FILE + 1)
    check_most(path, len(content), "bytes, unpacked")
    return partial(BytesIO, content)


def _text(path: Path) -> _Text:
    """Find labels and delimiter in the first line, the decimal sign in the next."""
    try:
        opened = _opener(path)
        with opened() as file:
            names, *rows, above = _first_lines(file)
            ahead = file.read(_LONGEST_LINE)
    except OSError as error:
        reason = error.strerror or error
        raise RecordingError(f"{path}: cannot be read: {reason}") from error
    header = _header(path, names)
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
    with suppress(ValueError):  # one is no number
        for label in labels:
            _number(label)
        raise RecordingError(
            f"{path}: the first line holds numbers; valid are column names such as "
            "time, q1, tau1"
        )
    first, second = (x.decode("utf-8", errors="replace") for x in rows)
    cells = _cells(first, delimiter)
    if units := _units(cells):
        pairs = zip_longest(labels, units, fillvalue="")
        labels = tuple(f"{x} [{unit}]" if unit else x for x, unit in pairs)
        first, above, cells = second, above + 1, _cells(second, delimiter)
    # At rest, all numbers may be whole.
    rows_ahead = first, second, *ahead.decode(errors="replace").split("\n")
    row = next((x for x in rows_ahead if "," in x or "." in x), ".")
    point = "." if delimiter == "," or "." in row else ","
    return _Text(path, opened, labels, delimiter, point, cells, above)


def _first_lines(file: BinaryIO) -> tuple[bytes, bytes, bytes, int]:
    """Line of column names, two lines below, and the number of lines down to it."""
    read = partial(file.readline, _LONGEST_LINE)
    lines = [read().removeprefix(BOM_UTF8)]
    while lines[-1].startswith(b"#") and len(lines) < _MOST_COMMENTS:
        lines.append(read())
    if len(lines) > 1 and re.match(rb"\s*[-+.\d]", lines[-1]):  # as NumPy writes
        return lines[-2].lstrip(b"# "), lines[-1], read(), len(lines) - 1
    return lines[-1], read(), read(), len(lines)


def _cells(line: str, delimiter: str) -> tuple[str, ...]:
    try:
        return tuple(next(csv.reader([line], delimiter=delimiter), ()))
    except csv.Error:  # the reader of all rows reports it
        return ()


def _units(cells: tuple[str, ...]) -> tuple[str, ...]:
    """Units of columns, if that is what a row holds: no number, and blanks or units."""
    units = tuple(x.strip().strip("[]()-") for x in cells)
    return units if any(units) and all(not x or fits(x) for x in units) else ()


def _header(path: Path, line: bytes) -> str:
    if line.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in line:
        raise RecordingError(
            f"{path}: not UTF-8 text (UTF-16 or binary); valid is CSV saved as UTF-8"
        )
    try:
        header = line.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"{path}: column names are not UTF-8 (byte "
            f"{error.object[error.start]:#04x}); valid is CSV saved as UTF-8"
        ) from error
    if "\r" in header:
        raise RecordingError(
            f"{path}: lines end in CR alone; valid are LF, and CR with LF"
        )
    return header


def _explanation(text: _Text, error: str) -> str:
    """Explain an error of NumPy, which counts rows and columns from 1."""
    ragged = r".* requires (\d+) columns but (\d+) were found at row (\d+)"
    if match := re.match(ragged, error):
        valid, found, row = map(int, match.groups())
        cells = f"{found} cells; valid are {valid}, one for each column name"
        return f"{row_words(row - 1)} has {cells}"
    wrong = r"could not convert string '(.*)' to .* at row (\d+), column (\d+)"
    if match := re.match(wrong, error):
        label, cell = text.labels[int(match[3]) - 1].strip(), match[1].strip()
        return f"{label}, {row_words(int(match[2]))}: {cell!r} is not a number"
    return f"cannot be read as CSV: {error.splitlines()[0]}"
