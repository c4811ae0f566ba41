"""Recordings as NumPy archives."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import RecordingError
from hybrid.names import printable
from hybrid.recording.table import (
    LARGEST_FILE,
    MOST_COLUMNS,
    LogTable,
    table_of_arrays,
)
from hybrid.recording.words import is_time, meaning, split_unit

_DAMAGE = (
    OSError,
    ValueError,
    EOFError,
    KeyError,
    NotImplementedError,  # an unknown compression
    RuntimeError,  # encrypted
    SyntaxError,  # a header that is none
    MemoryError,
    OverflowError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
)


def read_npz(path: Path) -> list[tuple[LogTable]]:
    """Arrays ``t``, ``q``, ``tau``, ..., or one for each column.

    Args:
        path: File; ``q`` and the like have shape (N, n), ``joints`` holds n names.

    Raises:
        RecordingError: The file is damaged, or an array has more than two dimensions.
    """
    source = str(path)
    arrays = _arrays(path)
    names = arrays.pop("joints", None)
    joints = None if names is None else tuple(map(str, np.atleast_1d(names)))
    return [(table_of_named(arrays, joints, source, "NPZ"),)]


def table_of_named(
    arrays: dict[str, NDArray[Any]],
    joints: tuple[str, ...] | None,
    source: str,
    kind: str,
    name: str = "",
) -> LogTable:
    """A table of arrays by name, whose matrices have a column for each joint.

    Args:
        arrays: Label -> array.
        joints: Joint names beside them; None if there are none.
        source: File for messages.
        kind: Name of the format.
        name: Which recording of the file.

    Raises:
        RecordingError: An array that a channel needs is not numbers in (N,) or (N, n).
    """
    columns: dict[str, NDArray[Any]] = {}
    for label, values in arrays.items():
        if is_time(split_unit(label)[0]) or meaning(label).channel:
            _check_numbers(values, label, source)
        if is_time(label) or values.ndim != 2:
            columns[label] = values
        else:
            columns |= _split(label, values, joints, source)
    return table_of_arrays(columns, source, joints=joints, kind=kind, name=name)


def _split(
    label: str, values: NDArray[Any], joints: tuple[str, ...] | None, source: str
) -> dict[str, NDArray[Any]]:
    """The columns of an array (N, n) under the labels they would have in a table."""
    if values.shape[1] > MOST_COLUMNS:  # an array without rows may state any number
        raise RecordingError(
            f"{source}: {printable(label)} has {values.shape[1]} columns; valid are up "
            f"to {MOST_COLUMNS}"
        )
    word, unit = split_unit(label)
    unit = f" [{unit}]" if unit else ""
    if joints is None:
        return {f"{word}[{k + 1}]{unit}": x for k, x in enumerate(values.T)}
    if meaning(label).channel and values.shape[1] != len(joints):
        raise RecordingError(
            f"{source}: {printable(label)} has {values.shape[1]} columns; valid are "
            f"{len(joints)}, one for each of joints {', '.join(joints)}"
        )
    pairs = zip(joints, values.T, strict=False)
    return {f"{word}_{joint}{unit}": column for joint, column in pairs}


def _check_numbers(
    values: NDArray[Any],
    label: str,
    source: str,
    dimensions: tuple[int, ...] = (1, 2),
) -> None:
    if values.ndim not in dimensions or values.dtype.kind not in "fiu":
        raise RecordingError(
            f"{source}: {printable(label)} has shape {values.shape} and type "
            f"{values.dtype}; "
            "valid are numbers, (N,) or (N, n)"
        )


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with zipfile.ZipFile(path) as archive:
            _check_sizes(archive, path)
            # No pickle: it runs code. All members are read, to find damage here.
            return {
                info.filename.removesuffix(".npy"): _member(archive, info, path)
                for info in archive.infolist()
            }
    except _DAMAGE as error:
        if _is_single_array(path):
            reason = "a single array; valid is an .npz archive with t, q and tau"
            raise RecordingError(f"{path}: {reason}") from error
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise RecordingError(
            f"{path}: not a whole NPZ file of plain arrays (truncated?): {reason}"
        ) from error


def _check_sizes(archive: zipfile.ZipFile, path: Path) -> None:
    """Refuse an archive that unpacks to more than any log."""
    total = sum(info.file_size for info in archive.infolist())
    if total > LARGEST_FILE:
        raise RecordingError(
            f"{path}: unpacks to {total:.3g} bytes; valid are logs of "
            f"{LARGEST_FILE:.3g} bytes or less"
        )


def _member(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path
) -> NDArray[Any]:
    """Read one array; its header must not claim more than the archive holds."""
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = _header(version, file)
        if dtype.hasobject or math.prod(shape) * dtype.itemsize > info.file_size:
            raise RecordingError(
                f"{path}: not a whole NPZ file of plain arrays (truncated?): "
                f"{info.filename} has shape {shape} of type {dtype} in "
                f"{info.file_size} bytes"
            )
    with archive.open(info) as file:
        return np.asarray(np.lib.format.read_array(file, allow_pickle=False))


def _header(version: tuple[int, int], file: IO[bytes]) -> tuple[Any, bool, Any]:
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    return np.lib.format.read_array_header_2_0(file)


def _is_single_array(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(6) == b"\x93NUMPY"
