"""Read tables in memory: of pandas, polars and pyarrow, or a dict of arrays."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import named_labels, table_of_arrays
from hybrid.recording.labels import is_time, split_unit
from hybrid.recording.table import LogTable

_UNNAMED = "__index_level_0__"  # an unnamed index of pandas in a file


def table_of_frame(frame: Any, source: str = "table", **more: Any) -> LogTable:
    """Make a table of a frame of pandas, polars or pyarrow, or of a dict of arrays.

    A column of lists has a column for each entry; ``more`` are fields of the table.
    """
    if isinstance(frame, Mapping):
        arrays = {str(label): np.asarray(x) for label, x in frame.items()}
        return table_of_arrays(arrays, source, kind="dict of arrays")
    more = {"kind": type(frame).__module__.split(".")[0], **more}
    if hasattr(frame, "reset_index"):
        frame = _with_index(frame)
    labels = getattr(frame, "column_names", getattr(frame, "columns", None))
    if labels is None:
        raise RecordingError(
            f"{source}: {type(frame).__name__} is no table; valid are tables of "
            "pandas, polars and pyarrow, and a dict of arrays"
        )
    arrays = {}
    for label in labels:
        x, name = _array(frame[label], str(label), source), str(label)
        if name == _UNNAMED and x.dtype.kind == "M":
            name = "time"
        if x.ndim == 2:
            arrays |= {f"{name}[{k}]": column for k, column in enumerate(x.T)}
        else:
            arrays[name] = x
    firsts = {name: x[0] for name, x in arrays.items() if len(x)}
    texts = {name: x for name, x in firsts.items() if isinstance(x, str)}
    names = named_labels(list(arrays), texts)
    arrays = dict(zip(names, arrays.values(), strict=True))
    return table_of_arrays(arrays, source, **more)


def _array(column: Any, label: str, source: str) -> AnyArray:
    """Samples of a column, shape (N,), or (N, n) if it holds lists."""
    x = np.asarray(column)
    try:
        if x.dtype == object and is_time(label):  # times of a zone
            x = np.asarray(column, dtype="datetime64[ns]")
    except ValueError as error:
        valid = "valid are numbers, or dates and times"
        raise RecordingError(f"{source}: {label} holds {x[0]!r}; {valid}") from error
    try:
        x = np.array(x.tolist()) if x.dtype == object else x
    except ValueError as error:
        raise RecordingError(f"{source}: lists of {label!r} of many lengths") from error
    return x / np.timedelta64(1, "s") if x.dtype.kind == "m" else x


def _with_index(frame: Any) -> Any:
    """Add the index of a pandas table as a column, if it holds times."""
    name = str(frame.index.name or "")
    if np.asarray(frame.index[:0]).dtype.kind == "M":
        return frame.rename_axis(name if is_time(name) else "time").reset_index()
    return frame.reset_index(drop=not is_time(split_unit(name)[0]))
