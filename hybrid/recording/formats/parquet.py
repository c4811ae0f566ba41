"""Read Parquet files, by pyarrow."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.extras import check_extra
from hybrid.recording.formats.fields import FieldColumn, field_table, named_labels
from hybrid.recording.table import (
    LARGEST_FILE,
    MOST_COLUMNS,
    LogTable,
    as_recording_error,
)

_LONGEST = 1000  # entries of a list that becomes columns


def check_parquet(path: Path) -> None:
    """Refuse a file that needs pyarrow where it is not installed."""
    check_extra("pyarrow", "parquet", f"{path}: Parquet")


def read_parquet(path: Path) -> list[tuple[LogTable]]:
    """Read a table with a column for each channel of each joint, or with lists."""
    check_parquet(path)
    from pyarrow import parquet

    source = str(path)
    with as_recording_error(path, "Parquet file"), parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        lists = [f.name for f in schema if _is_list(f.type)]
        lists = lists if rows and len(schema) <= MOST_COLUMNS else []
        first = next(file.iter_batches(1, columns=lists), None) if lists else None

    def get(names: Iterable[str]) -> dict[str, NDArray[Any]]:
        wanted = list(names)
        size = 8 * rows * len(wanted)
        if size > LARGEST_FILE:
            raise RecordingError(
                f"{source}: {rows} rows of {len(wanted)} columns are {size:.3g} bytes; "
                f"valid are {LARGEST_FILE:.3g} or less"
            )
        with (
            as_recording_error(path, "Parquet file"),
            parquet.ParquetFile(path) as file,
        ):
            table = file.read(columns=wanted)
        return {name: field_of(table, name, source) for name in wanted}

    layout = schema_columns(schema, first)
    return [(field_table(source, layout, get, kind="Parquet"),)]


def arrow_table(
    table: Any, source: str, *, left_out: str = "", **more: Any
) -> LogTable:
    """Make a log table of an Arrow table; ``more`` are further fields of it."""
    first = (table.slice(0, 1).combine_chunks().to_batches() or [None])[0]
    layout = [x for x in schema_columns(table.schema, first) if x[1] != left_out]
    return field_table(
        source,
        layout,
        lambda names: {name: field_of(table, name, source) for name in names},
        **more,
    )


def _is_list(kind: Any) -> bool:
    from pyarrow import types

    return any(f(kind) for f in (types.is_list, types.is_large_list,
                                 types.is_fixed_size_list))  # fmt: skip


def schema_columns(schema: Any, first: Any) -> list[FieldColumn]:
    """Columns of a schema; a list has a column for each of its entries.

    Args:
        schema: Arrow schema.
        first: Batch with the first row, which gives the lengths of lists; None if there
            are no rows.
    """
    from pyarrow import types

    layout: list[FieldColumn] = []
    texts: dict[str, str] = {}
    for f in schema:
        values = first.column(f.name)[0].as_py() if first and _is_list(f.type) else None
        if values is None or len(values) > _LONGEST:
            # an unnamed index of pandas is time if it holds dates
            index = f.name == "__index_level_0__" and types.is_timestamp(f.type)
            layout.append(("time" if index else f.name, f.name, None))
            continue
        for k, value in enumerate(values):
            layout.append((f"{f.name}[{k}]", f.name, k))
            if isinstance(value, str):
                texts[f"{f.name}[{k}]"] = value
    labels = named_labels([label for label, _, _ in layout], texts)
    return [(label, *x[1:]) for label, x in zip(labels, layout, strict=True)]


def field_of(table: Any, name: str, source: str) -> NDArray[Any]:
    """Samples of a column of an Arrow table, shape (N,), or (N, n) for lists."""
    from pyarrow import compute

    with as_recording_error(source, "Parquet file"):
        values = table.column(name)
        if _is_list(values.type):
            least = compute.min(compute.list_value_length(values)).as_py() or 0
            parts = [compute.list_element(values, k) for k in range(least)]
            columns = [_numbers(x, name, source) for x in parts]
            return np.stack(columns, axis=1) if columns else np.zeros((len(values), 0))
        return _numbers(values, name, source)


def _numbers(values: Any, name: str, source: str) -> NDArray[Any]:
    import pyarrow as pa
    from pyarrow import types

    kind = values.type
    if types.is_timestamp(kind) or types.is_date(kind):
        values = values.cast(pa.timestamp("ns"))
    elif types.is_duration(kind):
        return np.asarray(values.cast(pa.duration("ns")).cast(pa.int64())) / 1e9
    elif types.is_decimal(kind):
        values = values.cast(pa.float64())
    elif not (types.is_integer(kind) or types.is_floating(kind)):
        raise RecordingError(
            f"{source}: column {name!r} holds {kind}; valid are numbers"
        )
    return np.asarray(values.to_numpy())
