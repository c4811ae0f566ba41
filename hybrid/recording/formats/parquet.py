"""Read Parquet files, by pyarrow."""

from pathlib import Path
from typing import Any

from hybrid.errors import RecordingError
from hybrid.extras import check_extra
from hybrid.recording.table import LARGEST_FILE, MOST_COLUMNS, as_recording_error


def check_parquet(path: Path) -> None:
    """Refuse a file that needs pyarrow where it is not installed."""
    check_extra("pyarrow", "parquet", f"{path}: Parquet")


def arrow_table(path: Path, begin: tuple[str, ...] = ("",)) -> Any:
    """Read a table of pyarrow: numbers, dates, texts and their lists.

    Args:
        path: The file.
        begin: Beginnings of the names of the columns to read.
    """
    check_parquet(path)
    from pyarrow import parquet, types

    left_out = types.is_binary, types.is_large_binary, types.is_struct
    with as_recording_error(path, "Parquet file"), parquet.ParquetFile(path) as file:
        names = [
            f.name for f in file.schema_arrow
            if f.name.startswith(begin) and not any(kind(f.type) for kind in left_out)
        ]  # fmt: skip
        rows, columns = file.metadata.num_rows, len(names)
        if columns > MOST_COLUMNS or 8 * rows * columns > LARGEST_FILE:
            raise RecordingError(
                f"{path}: {rows} rows of {columns} columns; valid are up to "
                f"{MOST_COLUMNS} columns and {LARGEST_FILE:.3g} bytes"
            )
        return file.read(columns=names)
