"""Read tables in memory: of pandas, polars and pyarrow, or a dict of arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import named_labels, table_of_arrays
from hybrid.recording.labels import is_time, split_unit
from hybrid.recording.table import LogTable


def table_of_frame(frame: Any) -> LogTable:
    """Make a table of a frame; a column of lists has a column for each entry."""
    if isinstance(frame, Mapping):
        arrays = {str(label): np.asarray(x) for label, x in frame.items()}
        return table_of_arrays(arrays, "table", kind="dict of arrays")
    kind = type(frame).__module__.split(".")[0]
    if hasattr(frame, "reset_index"):
        frame = _with_index(frame)
    labels = getattr(frame, "column_names", getattr(frame, "columns", None))
    if labels is None:
        raise RecordingError(
            f"table: {type(frame).__name__} is no table; valid are tables of pandas, "
            "polars and pyarrow, and a dict of arrays"
        )
    arrays = {}
    for label in labels:
        x = _array(frame[label], str(label))
        many = {f"{label}[{k}]": column for k, column in enumerate(x.T)}
        arrays |= many if x.ndim == 2 else {str(label): x}
    texts = {k: x[0] for k, x in arrays.items() if x.dtype.kind == "U" and len(x)}
    names = named_labels(list(arrays), texts)
    arrays = dict(zip(names, arrays.values(), strict=True))
    return table_of_arrays(arrays, "table", kind=kind)


def _array(column: Any, label: str) -> NDArray[Any]:
    """Samples of a column, shape (N,), or (N, n) if it holds lists."""
    x = np.asarray(column)
    if x.dtype == object and is_time(label):  # times of a zone
        x = np.asarray(column, dtype="datetime64[ns]")
    try:
        return np.array(x.tolist()) if x.dtype == object else x
    except ValueError as error:
        raise RecordingError(f"table: lists of {label!r} of many lengths") from error


def _with_index(frame: Any) -> Any:
    """Add the index of a pandas table as a column, if it holds times."""
    name = str(frame.index.name or "")
    if np.asarray(frame.index[:0]).dtype.kind == "M":
        return frame.rename_axis(name if is_time(name) else "time").reset_index()
    timed = bool(name) and is_time(split_unit(name)[0])
    return frame.reset_index(drop=not timed)
