"""Read recordings from NumPy archives."""

import math
import zipfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.errors import RecordingError
from hybrid.recording.formats.fields import table_of_arrays
from hybrid.recording.table import LogTable, as_recording_error, check_most

_KIND = "NPZ file of plain arrays"


def read_npz(path: Path) -> list[tuple[LogTable]]:
    """Read arrays ``t``, ``q``, ``tau``, ..., or one array for each column."""

    def get(names: Iterable[str]) -> dict[str, AnyArray]:
        # A pickle could run code.
        with (
            as_recording_error(path, _KIND),
            np.load(path, allow_pickle=False) as archive,
        ):
            return {name: np.asarray(archive[name]) for name in names}

    return [(table_of_arrays(_shapes(path), str(path), get=get, kind="NPZ"),)]


def _shapes(path: Path) -> dict[str, AnyArray]:
    """Arrays of zeros that take no memory, with the shape and type of each array."""
    with path.open("rb") as file:
        if file.read(6) == b"\x93NUMPY":
            raise RecordingError(
                f"{path}: a single array; valid is an .npz archive with t, q and tau"
            )
    with as_recording_error(path, _KIND), zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        check_most(path, sum(x.file_size for x in members), "bytes, unpacked")
        return {x.filename.removesuffix(".npy"): _shape(archive, x) for x in members}


def _shape(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> AnyArray:
    """Array of zeros from a header, whose shape must fit the size of the file."""
    form, size = np.lib.format, info.file_size
    with archive.open(info) as file:
        old = form.read_magic(file) == (1, 0)
        read = form.read_array_header_1_0 if old else form.read_array_header_2_0
        shape, _, dtype = read(file)
    if dtype.hasobject or math.prod(shape) * dtype.itemsize > size:
        raise ValueError(f"{info.filename} is {shape} of {dtype} in {size} bytes")
    return np.broadcast_to(np.zeros((), dtype), shape)
