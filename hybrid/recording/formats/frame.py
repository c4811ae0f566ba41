"""Read tables in memory: pandas, polars, pyarrow, or a dict of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import table_of_arrays
from hybrid.recording.formats.parquet import arrow_table
from hybrid.recording.labels import is_time, split_unit
from hybrid.recording.table import LogTable


def table_of_frame(frame: Any) -> LogTable:
    """Read a table by Arrow's protocol or the interchange protocol."""
    if isinstance(frame, Mapping):
        arrays = {str(label): np.asarray(x) for label, x in frame.items()}
        return table_of_arrays(arrays, "table", kind="dict of arrays")
    import pyarrow as pa
    from pyarrow.interchange import from_dataframe

    if hasattr(frame, "index") and hasattr(frame, "reset_index"):
        frame = _with_index(frame)
    try:
        plain = isinstance(frame, pa.Table) or hasattr(frame, "__arrow_c_stream__")
        table = pa.table(frame) if plain else from_dataframe(frame)
    except (AttributeError, TypeError, ValueError, pa.ArrowException) as error:
        raise RecordingError(
            f"table: {type(frame).__name__} is no table; valid are tables of pandas, "
            "polars and pyarrow, and a dict of arrays"
        ) from error
    return arrow_table(table, "table", kind=type(frame).__module__.split(".")[0])


def _with_index(frame: Any) -> Any:
    """Add the index of a pandas table as a column, if it holds times."""
    name = str(frame.index.name or "")
    if np.asarray(frame.index[:0]).dtype.kind == "M":
        return frame.rename_axis(name if is_time(name) else "time").reset_index()
    timed = bool(name) and is_time(split_unit(name)[0])
    return frame.reset_index(drop=not timed)
