"""Write recordings, and other columns of numbers, to files."""

import csv
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.errors import RecordingError
from hybrid.extras import check_extra
from hybrid.files import atomic_path
from hybrid.recording.recording import Recording, numbered_joints

Columns = Mapping[str, AnyArray]


def write(recording: Recording, path: str | Path) -> None:
    """Write one recording by :func:`write_columns`; it reads back equal.

    Raises:
        RecordingError: The suffix is unknown or the file cannot be written.
    """
    numbered = recording.joints == numbered_joints(recording.size)
    columns: dict[str, AnyArray] = {"time": recording.t}
    for channel, x in recording.channels.items():
        for k, joint in enumerate(recording.joints):
            columns[f"{channel}{k + 1}" if numbered else f"{channel}_{joint}"] = x[:, k]
    if Path(path).suffix.lower() == ".npz":
        columns = {"t": recording.t, "joints": np.array(recording.joints)}
        columns |= recording.channels
    try:
        write_columns(path, columns)
    except OSError as error:
        raise RecordingError(
            f"{path}: cannot be written: {error.strerror or error}"
        ) from error


def write_columns(path: str | Path, columns: Columns) -> None:
    """Write columns to a ``.csv``, ``.parquet`` or ``.npz`` file.

    The file is written whole or not at all, and every number reads back exactly.

    Args:
        path: Path of the file.
        columns: Samples by label, each of shape (N,).

    Raises:
        RecordingError: The suffix is unknown.
    """
    path = Path(path)
    writer = writer_of(path)
    with atomic_path(path) as temporary:
        writer(columns, temporary)


def writer_of(path: Path) -> Callable[[Columns, Path], None]:
    """Function that writes files of this suffix."""
    if path.suffix.lower() not in WRITERS:
        raise RecordingError(
            f"{path}: unknown kind of file; valid are {', '.join(WRITERS)}"
        )
    if path.suffix.lower() == ".parquet":
        check_extra("pyarrow", "parquet", f"{path}: Parquet")
    return WRITERS[path.suffix.lower()]


def _write_csv(columns: Columns, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(columns)
        lines.writerows(zip(*(x.tolist() for x in columns.values()), strict=True))


def _write_parquet(columns: Columns, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    parquet.write_table(pa.table(dict(columns)), path)


def _write_npz(columns: Columns, path: Path) -> None:
    np.savez(path, **dict(columns))  # type: ignore[arg-type]


WRITERS: dict[str, Callable[[Columns, Path], None]] = {
    ".csv": _write_csv,
    ".parquet": _write_parquet,
    ".npz": _write_npz,
}
