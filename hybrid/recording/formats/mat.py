"""Read MATLAB files: version 5 by SciPy, version 7.3 by h5py."""

import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.recording.formats.fields import NAMES, table_of_arrays
from hybrid.recording.formats.hdf5 import arrays_of
from hybrid.recording.labels import is_time, split_unit
from hybrid.recording.table import (
    LARGEST_FILE,
    LogTable,
    as_recording_error,
    check_most,
)

_HEADER = 128  # bytes; the last two give the byte order
_MATRIX, _COMPRESSED, _LAST = 14, 15, 18  # types of elements; valid are 1 to the last
_NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
_TEXT = frozenset((1, 2, 3, 4, 5, 6, 7, 16, 17, 18))
# Valid types of the first three elements of an array: flags, dimensions, name.
_FIRST = ((6,), (5, 6), (1, 16))
_CHAR, _SPARSE, _HIGHEST = 4, 5, 15  # classes; 6 to the highest are dense numbers
_COMPLEX = 0x800
_DEEPEST = 32  # nesting levels of structs and cells


def read_mat(path: Path) -> list[tuple[LogTable]]:
    """Read the variables of a file, or the fields of its only struct."""
    with path.open("rb") as file:
        head = file.read(128)
    with as_recording_error(path, "MATLAB file"):
        if head[:10] == b"MATLAB 7.3":  # an HDF5 file of transposed arrays
            found = {k.replace("/", "."): x.T for k, x in arrays_of(path)[0].items()
                     if k[0] != "#"}  # fmt: skip
        else:
            found = _version_5(path)
    structs = {name.split(".")[0] for name in found if "." in name}
    if len(structs) == 1:
        found = {name.split(".", 1)[-1]: x for name, x in found.items()}
    plain = {k: x for k, x in found.items() if x.dtype.kind in "fiu" and x.ndim < 3}
    arrays = {k: found[k] for k in NAMES if k in found and found[k].dtype.kind == "U"}
    times = [x.size for k, x in plain.items() if is_time(split_unit(k)[0])]
    rows = max(times, default=0)
    for name, x in plain.items():
        if x.ndim == 2 and x.shape[1] == rows != x.shape[0]:  # samples in columns
            x = x.T
        arrays[name] = x[:, 0] if x.ndim == 2 and x.shape[1] == 1 else x
    return [(table_of_arrays(arrays, str(path), kind="MATLAB"),)]


def _version_5(path: Path) -> dict[str, AnyArray]:
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about variables that SciPy cannot read
        check_elements(path)
        content = scipy.io.loadmat(path, squeeze_me=False, chars_as_strings=True)
    found: dict[str, AnyArray] = {}
    for name, x in content.items():
        if name.startswith("__"):
            continue
        if isinstance(x, np.ndarray) and x.dtype.names and x.size == 1:
            found |= {f"{name}.{k}": _plain(x[k].item()) for k in x.dtype.names}
        else:
            found[name] = _plain(x)
    return found


def _plain(x: Any) -> AnyArray:
    """Convert a variable to an array; a cell array of texts becomes texts."""
    plain: AnyArray = np.asarray(x)
    cells = [np.asarray(v) for v in plain.ravel()] if plain.dtype == object else []
    if cells and all(v.dtype.kind == "U" and v.size for v in cells):
        return np.array([str(v.ravel()[0]) for v in cells])
    return plain


def check_elements(path: Path) -> None:
    """Check all elements of a file of version 5 before SciPy reads them.

    SciPy checks neither the types of elements nor whether an array has the elements
    that its class needs: a damaged file would crash the process (SciPy 1.17).

    Source: MathWorks, MAT-File Format, "Level 5 MAT-File Format".
    """
    total = 0
    with path.open("rb") as file:
        head = file.read(_HEADER)
        if 0 in head[:4]:  # version 4
            return
        order = ">" if head[126:] == b"MI" else "<"
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            data = file.read(min(length, LARGEST_FILE))
            if kind == _COMPRESSED:
                room = LARGEST_FILE - total + 1
                data = zlib.decompressobj().decompress(data, room)
                total += len(data)
            check_most(path, total, "bytes, unpacked")
            if kind in (_COMPRESSED, _MATRIX):
                _check_array(memoryview(data), order, int(kind == _MATRIX))


def _check_array(data: memoryview, order: str, depth: int) -> None:
    """Check the elements of an array, and those of arrays in it."""
    kinds: list[int] = []
    at, flags = 0, 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        room = 8 + -(-length // 8) * 8
        if kind >> 16:  # small element: the upper half of its type is its length
            kind, length, room = kind & 0xFFFF, 0, 8
        if not 0 < kind <= _LAST or depth > _DEEPEST:
            raise ValueError("an element is not of its type")
        if kind == _MATRIX:
            _check_array(data[at + 8 : at + 8 + length], order, depth + 1)
        elif not kinds and at + 12 <= len(data):
            (flags,) = struct.unpack_from(f"{order}I", data, at + 8)
        kinds.append(kind)
        at += room
    if depth and kinds and not _holds_numbers(kinds, flags):
        raise ValueError("an element is not of its type")


def _holds_numbers(kinds: list[int], flags: int) -> bool:
    """Tell whether an array has the elements that its class needs, of valid types."""
    kind, own = flags & 0xFF, kinds[3:]
    if not _CHAR <= kind <= _HIGHEST:
        return True
    parts = (3 if kind == _SPARSE else 1) + bool(flags & _COMPLEX)
    valid = _TEXT if kind == _CHAR else _NUMBERS
    first = all(x in types for x, types in zip(kinds, _FIRST, strict=False))
    return first and len(own) >= parts and valid.issuperset(own)
