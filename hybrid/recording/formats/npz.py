"""Recordings as NumPy archives."""

from __future__ import annotations

import math
import zipfile
from dataclasses import replace
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
    whole,
)
from hybrid.recording.words import is_time, meaning, split_unit

_KIND = "NPZ file of plain arrays"


def read_npz(path: Path) -> list[tuple[LogTable]]:
    """Arrays ``t``, ``q``, ``tau``, ..., or one for each column.

    Args:
        path: File; ``q`` and the like have shape (N, n), ``joints`` holds n names.

    Raises:
        RecordingError: The file is damaged, or an array has more than two dimensions.
    """
    shapes, joints = _shapes(path), None
    if shapes.pop("joints", None) is not None:
        joints = tuple(map(str, np.atleast_1d(_array(path, "joints"))))

    def table_of(arrays: dict[str, NDArray[Any]]) -> LogTable:
        return table_of_named(arrays, joints, str(path), "NPZ")

    def load(used: tuple[int, ...]) -> list[dict[int, NDArray[Any]]]:
        labels = {table.labels[k] for k in used}
        arrays = {
            name: x if labels.isdisjoint(table_of({name: x}).labels)
            else _array(path, name)
            for name, x in shapes.items()
        }  # fmt: skip
        return table_of(arrays).load(used)

    table = table_of(shapes)
    return [(replace(table, load=load),)]


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


def _shapes(path: Path) -> dict[str, NDArray[Any]]:
    """Every array by its shape and type alone: zeros that take no memory."""
    with path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise RecordingError(
                f"{path}: a single array; valid is an .npz archive with t, q and tau"
            )
    with whole(path, _KIND), zipfile.ZipFile(path) as archive:
        _check_sizes(archive, path)
        return {
            info.filename.removesuffix(".npy"): _shape(archive, info, path)
            for info in archive.infolist()
        }


def _array(path: Path, name: str) -> NDArray[Any]:
    # No pickle: it runs code.
    with whole(path, _KIND), np.load(path, allow_pickle=False) as archive:
        return np.asarray(archive[name])


def _check_sizes(archive: zipfile.ZipFile, path: Path) -> None:
    """Refuse an archive that unpacks to more than any log."""
    total = sum(info.file_size for info in archive.infolist())
    if total > LARGEST_FILE:
        raise RecordingError(
            f"{path}: unpacks to {total:.3g} bytes; valid are logs of "
            f"{LARGEST_FILE:.3g} bytes or less"
        )


def _shape(archive: zipfile.ZipFile, info: zipfile.ZipInfo, path: Path) -> NDArray[Any]:
    """An array as its header has it, which must not claim more than there is."""
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = _header(version, file)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > info.file_size:
        raise RecordingError(
            f"{path}: not a whole {_KIND} (truncated?): {info.filename} has shape "
            f"{shape} of type {dtype} in {info.file_size} bytes"
        )
    return np.broadcast_to(np.zeros((), dtype), shape)


def _header(version: tuple[int, int], file: IO[bytes]) -> tuple[Any, bool, Any]:
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(file)
    return np.lib.format.read_array_header_2_0(file)
