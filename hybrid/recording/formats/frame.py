"""Tables in memory: pandas, polars, pyarrow, or a dict of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.errors import RecordingError
from hybrid.recording.formats.npz import table_of_named
from hybrid.recording.formats.parquet import loaded, spread_columns
from hybrid.recording.table import LogTable


def table_of_frame(frame: Any) -> LogTable:
    """A table of a library with Arrow's protocol or the interchange protocol.

    Args:
        frame: pandas, polars or pyarrow table, or label -> array.

    Raises:
        RecordingError: It is none of these.
    """
    if isinstance(frame, Mapping):
        arrays = {str(label): np.asarray(x) for label, x in frame.items()}
        return table_of_named(arrays, None, "table", "dict of arrays")
    import pyarrow as pa

    if hasattr(frame, "index") and hasattr(frame, "reset_index"):
        frame = _with_index(frame)
    try:
        if isinstance(frame, pa.Table):
            table = frame
        elif hasattr(frame, "__arrow_c_stream__"):
            table = pa.table(frame)
        else:
            from pyarrow.interchange import from_dataframe

            table = from_dataframe(frame)
    except (AttributeError, TypeError, ValueError, pa.ArrowException) as error:
        raise RecordingError(
            f"table: {type(frame).__name__} is no table; valid are tables of pandas, "
            "polars and pyarrow, and a dict of arrays"
        ) from error
    rows = table.slice(0, 1).combine_chunks().to_batches()
    spread = spread_columns(table.schema, rows[0] if rows else None)
    labels = tuple(label for label, _, _ in spread)
    load = loaded(table, spread, "table")
    return LogTable("table", labels, load, kind=type(frame).__module__.split(".")[0])


def _with_index(frame: Any) -> Any:
    """A table of pandas with its index as a column of time, if it is one."""
    from hybrid.recording.words import is_time, split_unit

    name = str(frame.index.name or "")
    if np.asarray(frame.index[:0]).dtype.kind == "M":
        return frame.rename_axis(name if is_time(name) else "time").reset_index()
    if name and is_time(split_unit(name)[0]):
        return frame.reset_index()
    return frame.reset_index(drop=True)
