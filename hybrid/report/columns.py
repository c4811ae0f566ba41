"""Columns of numbers on disk, for spreadsheets and other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.files import atomic_path

Columns = Mapping[str, Array]


def write_columns(path: str | Path, columns: Columns) -> None:
    """Write columns; the suffix, ``.csv``, ``.parquet`` or ``.npz``, says how.

    The file appears whole or not at all, and every number reads back to the last bit.

    Args:
        path: Where the file shall be.
        columns: Samples by label, each of shape (N,).

    Raises:
        HybridError: The suffix is unknown.
    """
    path = Path(path)
    writer = writer_of(path)
    with atomic_path(path) as temporary:
        writer(columns, temporary)


def writer_of(path: Path) -> Callable[[Columns, Path], None]:
    """The function that writes files of this suffix.

    Raises:
        HybridError: The suffix is unknown.
    """
    if path.suffix.lower() not in WRITERS:
        raise HybridError(f"{path}: unknown kind; valid are {', '.join(WRITERS)}")
    return WRITERS[path.suffix.lower()]


def _write_csv(columns: Columns, path: Path) -> None:
    import pyarrow as pa
    from pyarrow import csv

    options = csv.WriteOptions(quoting_style="needed")
    csv.write_csv(pa.table(dict(columns)), path, options)


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
