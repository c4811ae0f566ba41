"""Parquet tables, with the conventions of pandas for an index and for lists."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.table import (
    LARGEST_FILE,
    MOST_COLUMNS,
    Load,
    LogTable,
    named_labels,
    whole,
)

Spread = tuple[str, str, int | None]  # label, field, place in its list


def read_parquet(path: Path) -> list[tuple[LogTable]]:
    """A table with a column for each channel of each joint, or lists of them.

    Args:
        path: File.

    Raises:
        RecordingError: The file is damaged; a column that is loaded is not of numbers.
    """
    from pyarrow import parquet

    source = str(path)
    with whole(path, "Parquet file"), parquet.ParquetFile(path) as file:
        schema, rows = file.schema_arrow, file.metadata.num_rows
        lists = _lists(schema) if rows and len(schema) <= MOST_COLUMNS else []
        first = next(file.iter_batches(1, columns=lists), None) if lists else None
    spread = spread_columns(schema, first)
    labels = tuple(label for label, _, _ in spread)

    def load(used: tuple[int, ...]) -> list[dict[int, NDArray[Any]]]:
        size = 8 * rows * len(used)
        if size > LARGEST_FILE:
            raise RecordingError(
                f"{source}: {rows} rows of {len(used)} columns are {size:.3g} bytes; "
                f"valid are {LARGEST_FILE:.3g} or less"
            )
        names = list(dict.fromkeys(spread[k][1] for k in used))
        with whole(path, "Parquet file"), parquet.ParquetFile(path) as file:
            table = file.read(columns=names)
        return loaded(table, spread, source)(used)

    return [(LogTable(source, labels, load, kind="Parquet"),)]


def loaded(table: Any, spread: Sequence[Spread], source: str) -> Load:
    """The columns of an Arrow table at hand, by their indices in ``spread``.

    Args:
        table: Arrow table.
        spread: Its columns with those in lists, as :func:`spread_columns` has them.
        source: File for messages.
    """
    return lambda used: [{k: column_of(table, spread[k], source) for k in used}]


def _lists(schema: Any) -> list[str]:
    return [f.name for f in schema if _is_list(f.type)]


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    return any(
        check(kind)
        for check in (pa.types.is_list, pa.types.is_large_list,
                      pa.types.is_fixed_size_list)
    )  # fmt: skip


def spread_columns(schema: Any, first: Any) -> list[Spread]:
    """Label, field and place in its list of every column; lists are spread out.

    Args:
        schema: Arrow schema.
        first: Batch of the first row of the lists, whose lengths count; None if there
            are no rows.
    """
    spread: list[Spread] = []
    texts: dict[str, str] = {}
    for f in schema:
        values = first.column(f.name)[0].as_py() if first and _is_list(f.type) else None
        if values is None or len(values) > 1000:
            # a nameless index of pandas, which is time if it holds dates
            name = "time" if f.name == "__index_level_0__" and _is_date(f.type) else ""
            spread.append((name or f.name, f.name, None))
            continue
        spread += [(f"{f.name}[{k}]", f.name, k) for k in range(len(values))]
        places = enumerate(values)
        texts |= {f"{f.name}[{k}]": x for k, x in places if isinstance(x, str)}
    labels = named_labels([label for label, _, _ in spread], texts)
    pairs = zip(labels, spread, strict=True)
    return [(label, name, place) for label, (_, name, place) in pairs]


def _is_date(kind: Any) -> bool:
    import pyarrow as pa

    return bool(pa.types.is_timestamp(kind))


def column_of(table: Any, column: Spread, source: str) -> NDArray[Any]:
    """Samples of one column, spread from its list if it is one.

    Args:
        table: Arrow table.
        column: Label, field and place in its list.
        source: File for messages.

    Raises:
        RecordingError: It does not hold numbers, or its lists are of many lengths.
    """
    import pyarrow as pa
    from pyarrow import compute

    label, name, place = column
    values = table.column(name)
    with whole(source, "Parquet file"):
        if place is not None:
            lengths = compute.list_value_length(values)
            longest = compute.min_max(lengths).as_py()
            if longest["min"] is None or longest["min"] <= place:
                raise RecordingError(f"{source}: lists of {name!r} of many lengths")
            values = compute.list_element(values, place)
        kind = values.type
        if pa.types.is_timestamp(kind) or pa.types.is_date(kind):
            return np.asarray(values.cast(pa.timestamp("ns")).to_numpy())
        if pa.types.is_duration(kind):
            count = values.cast(pa.duration("ns")).cast(pa.int64()).to_numpy()
            return np.asarray(count / 1e9)
        if pa.types.is_decimal(kind):
            values, kind = values.cast(pa.float64()), pa.float64()
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
        raise RecordingError(
            f"{source}: column {label!r} holds {kind}; valid are numbers"
        )
    return np.asarray(values.to_numpy())
