"""Recordings as NumPy archives."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.recording.columns import TIME, match_columns, word_channel
from hybrid.recording.recording import Recording
from hybrid.recording.table import recording_from_layout

_DAMAGE = (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error)


def read_npz(path: Path, *, joints: tuple[str, ...] | None = None) -> Recording:
    """Read ``t``, ``q``, ``tau``, ... as arrays, or a column for each joint.

    Args:
        path: File; ``q`` and the like have shape (N, n), ``joints`` holds n names.
        joints: Joint names of the robot, base to tip; None if not known.

    Raises:
        RecordingError: The file is damaged, or its arrays are not a valid recording.

    Warns:
        HybridWarning: Arrays were ignored, or time looks like milliseconds.
    """
    source = str(path)
    arrays = _arrays(path)
    names = arrays.pop("joints", None)
    columns: dict[str, NDArray[Any]] = {}
    found: tuple[str, ...] | None = None
    if names is not None:
        found = tuple(str(name) for name in np.atleast_1d(names))
    for label, values in arrays.items():
        if label.lower() in TIME or values.ndim != 2:
            columns[label] = values
            continue
        width = values.shape[1]
        if word_channel(label) and found is not None and width != len(found):
            raise RecordingError(
                f"{source}: {label} has {width} columns; valid are {len(found)}, one "
                f"for each of joints {', '.join(found)}"
            )
        for k in range(width):
            columns[f"{label}_{found[k]}" if found else f"{label}{k + 1}"] = values[
                :, k
            ]
    labels = list(columns)
    layout = match_columns(labels, joints=joints or found, source=source)

    def column(index: int) -> NDArray[np.float64]:
        values = columns[labels[index]]
        if values.ndim != 1 or values.dtype.kind not in "fiu":
            raise RecordingError(
                f"{source}: {labels[index]} has shape {values.shape} and type "
                f"{values.dtype}; valid are numbers, (N,) or (N, n)"
            )
        return np.asarray(values, dtype=np.float64)

    return recording_from_layout(layout, column, source=source)


def write_npz(recording: Recording, path: Path) -> None:
    """Write a log as arrays ``t``, ``q``, ... and the names ``joints``."""
    arrays = {"t": recording.t, "joints": np.array(recording.joints)}
    np.savez(path, **(arrays | recording.channels))  # type: ignore[arg-type]


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        # Not mmap: a damaged member must be found here. No pickle: it runs code.
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except AttributeError as error:
        raise RecordingError(
            f"{path}: a single array; valid is an .npz archive with t, q and tau"
        ) from error
    except _DAMAGE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(
            f"{path}: not a whole NPZ file of plain arrays (truncated?): {reason}"
        ) from error
