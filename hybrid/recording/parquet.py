"""Recordings as Parquet tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.columns import LARGEST_FILE, match_columns
from hybrid.recording.recording import Recording
from hybrid.recording.table import labels_of, recording_from_layout


def read_parquet(
    path: Path, *, joints: tuple[str, ...] | None = None, torque: bool = True
) -> Recording:
    """Read a log with a column for each channel of each joint.

    Args:
        path: File.
        joints: Joint names of the robot, base to tip; None if not known.
        torque: Refuse a log without torques.

    Raises:
        RecordingError: The file is damaged or empty, or a column is not of numbers.

    Warns:
        HybridWarning: Columns were ignored.
    """
    import pyarrow as pa
    from pyarrow import parquet

    source = str(path)
    try:
        with parquet.ParquetFile(path) as file:
            labels = file.schema_arrow.names
            layout = match_columns(labels, joints=joints, source=source, torque=torque)
            size = 8 * file.metadata.num_rows * len(layout.used)
            if size > LARGEST_FILE:
                raise RecordingError(
                    f"{source}: {file.metadata.num_rows} rows of {len(layout.used)} "
                    f"columns are {size:.3g} bytes; valid are {LARGEST_FILE:.3g} or "
                    "less"
                )
            table = file.read(columns=[labels[k] for k in layout.used])
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).splitlines()[0]
        raise RecordingError(
            f"{source}: not a whole Parquet file (truncated?): {reason}"
        ) from error

    def column(index: int) -> NDArray[np.float64]:
        values = table.column(labels[index])
        if not (pa.types.is_integer(values.type) or pa.types.is_floating(values.type)):
            raise RecordingError(
                f"{source}: column {labels[index]!r} holds {values.type}; valid are "
                "numbers"
            )
        return np.asarray(values.to_numpy(), dtype=np.float64)

    return recording_from_layout(layout, column, source=source)


def write_parquet(recording: Recording, path: Path) -> None:
    """Write a log so that every number reads back to the last bit."""
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(labels_of(recording)), path)
