"""Recordings -> files."""

from __future__ import annotations

from pathlib import Path

from hybrid.errors import RecordingError
from hybrid.files import atomic_path
from hybrid.recording.formats.csv import write_csv
from hybrid.recording.formats.npz import write_npz
from hybrid.recording.formats.parquet import write_parquet
from hybrid.recording.recording import Recording

WRITERS = {".csv": write_csv, ".parquet": write_parquet, ".npz": write_npz}


def write(recording: Recording, path: str | Path) -> None:
    """Write one recording; it reads back equal to the last bit.

    The file appears whole or not at all: if writing fails, an older file stays.

    Args:
        recording: Joint log.
        path: ``.csv``, ``.parquet`` or ``.npz`` file.

    Raises:
        RecordingError: The suffix is unknown or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise RecordingError(
            f"{path}: unknown kind of recording; valid are {', '.join(WRITERS)}"
        )
    try:
        with atomic_path(path) as temporary:
            WRITERS[path.suffix.lower()](recording, temporary)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error}") from error
