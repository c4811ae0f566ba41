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


def read_npz(
    path: Path, *, joints: tuple[str, ...] | None = None, torque: bool = True
) -> Recording:
    """Read ``t``, ``q``, ``tau``, ... as arrays, or a column for each joint.

    Args:
        path: File; ``q`` and the like have shape (N, n), ``joints`` holds n names.
        joints: Joint names of the robot, base to tip; None if not known.
        torque: Refuse a log without torques.

    Raises:
        RecordingError: The file is damaged, or its arrays are not a valid recording.

    Warns:
        HybridWarning: Arrays were ignored, or time looks like milliseconds.
    """
    source = str(path)
    arrays = _arrays(path)
    names = arrays.pop("joints", None)
    found = None if names is None else tuple(map(str, np.atleast_1d(names)))
    columns: dict[str, NDArray[Any]] = {}
    for label, values in arrays.items():
        if label.lower() in TIME or word_channel(label):
            _check_numbers(values, label, source)
        if label.lower() in TIME or values.ndim != 2:
            columns[label] = values
        else:
            columns |= _split(label, values, found, source)
    labels = list(columns)
    layout = match_columns(labels, joints=joints or found, source=source, torque=torque)

    def column(index: int) -> NDArray[np.float64]:
        values = columns[labels[index]]
        _check_numbers(values, labels[index], source, dimensions=(1,))
        return np.asarray(values, dtype=np.float64)

    return recording_from_layout(layout, column, source=source)


def write_npz(recording: Recording, path: Path) -> None:
    """Write a log as arrays ``t``, ``q``, ... and the names ``joints``."""
    arrays = {"t": recording.t, "joints": np.array(recording.joints)}
    np.savez(path, **(arrays | recording.channels))  # type: ignore[arg-type]


def _split(
    label: str, values: NDArray[Any], joints: tuple[str, ...] | None, source: str
) -> dict[str, NDArray[Any]]:
    """The columns of an array (N, n) under the labels they would have in a table."""
    if joints is None:
        return {f"{label}{k + 1}": column for k, column in enumerate(values.T)}
    if word_channel(label) and values.shape[1] != len(joints):
        raise RecordingError(
            f"{source}: {label} has {values.shape[1]} columns; valid are "
            f"{len(joints)}, one for each of joints {', '.join(joints)}"
        )
    pairs = zip(joints, values.T, strict=False)
    return {f"{label}_{joint}": column for joint, column in pairs}


def _check_numbers(
    values: NDArray[Any],
    label: str,
    source: str,
    dimensions: tuple[int, ...] = (1, 2),
) -> None:
    if values.ndim not in dimensions or values.dtype.kind not in "fiu":
        raise RecordingError(
            f"{source}: {label} has shape {values.shape} and type {values.dtype}; "
            "valid are numbers, (N,) or (N, n)"
        )


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        # No pickle: it runs code. All members are read here, to find damage here.
        with path.open("rb") as file:
            archive = np.load(file, allow_pickle=False)
            if isinstance(archive, np.lib.npyio.NpzFile):
                return {name: archive[name] for name in archive.files}
    except _DAMAGE as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(
            f"{path}: not a whole NPZ file of plain arrays (truncated?): {reason}"
        ) from error
    raise RecordingError(
        f"{path}: a single array; valid is an .npz archive with t, q and tau"
    )
