"""Files, folders and globs -> recordings."""

from __future__ import annotations

import glob
from collections.abc import Iterable
from pathlib import Path

from hybrid.errors import RecordingError
from hybrid.recording.columns import LARGEST_FILE
from hybrid.recording.csv import read_csv
from hybrid.recording.npz import read_npz
from hybrid.recording.parquet import read_parquet
from hybrid.recording.recording import Recording

READERS = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".parquet": read_parquet,
    ".npz": read_npz,
}


def read(
    path: str | Path, *, joints: tuple[str, ...] | None = None, torque: bool = True
) -> Recording:
    """Read one recording.

    Args:
        path: ``.csv``, ``.tsv``, ``.parquet`` or ``.npz`` file.
        joints: Joint names of the robot, base to tip: columns by name are put in this
            order, columns by number get these names. None keeps the file's.
        torque: Refuse a log without torques.

    Raises:
        RecordingError: The file is missing, of an unknown kind, or not a valid log.

    Warns:
        HybridWarning: Columns were ignored.
    """
    path = Path(path)
    if path.suffix.lower() not in READERS:
        raise RecordingError(
            f"{path}: unknown kind of recording; valid are {', '.join(READERS)}"
        )
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if (size := path.stat().st_size) > LARGEST_FILE:
        raise RecordingError(
            f"{path}: {size:.3g} bytes; valid are {LARGEST_FILE:.3g} or less"
        )
    return READERS[path.suffix.lower()](path, joints=joints, torque=torque)


def read_all(
    paths: str | Path | Iterable[str | Path],
    *,
    joints: tuple[str, ...] | None = None,
    torque: bool = True,
) -> list[Recording]:
    """Read all recordings of files, folders and globs.

    Args:
        paths: One or more of: a file; a folder, for all recordings in it; a glob.
            Folders and globs give their files in alphabetical order.
        joints: As in :func:`read`.
        torque: As in :func:`read`.

    Raises:
        RecordingError: A path holds no recording, or one is not valid.

    Warns:
        HybridWarning: Columns were ignored.
    """
    if isinstance(paths, (str, Path)):
        paths = [paths]
    files = dict.fromkeys(file for path in paths for file in _files(Path(path)))
    if not files:
        raise RecordingError("no paths given; valid are files, folders and globs")
    return [read(file, joints=joints, torque=torque) for file in files]


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    if path.is_dir():
        candidates = sorted(path.iterdir())
    else:
        candidates = [Path(name) for name in sorted(glob.glob(str(path)))]
    found = [
        file
        for file in candidates
        # a name that starts with a dot is a file still being written
        if file.suffix.lower() in READERS and file.is_file() and file.name[0] != "."
    ]
    if not found:
        raise RecordingError(
            f"{path}: no recordings there; valid are files, folders and globs of "
            f"{', '.join(READERS)}"
        )
    return found
