"""Check the elements of a MATLAB file of version 5 before SciPy reads them.

SciPy does not check the types of elements, nor whether an array has the elements that
its class needs. A damaged file therefore crashes the process (SciPy 1.17).

Source: MathWorks, MAT-File Format, "Level 5 MAT-File Format".
"""

import struct
import zlib
from pathlib import Path

from hybrid.errors import RecordingError
from hybrid.recording.table import LARGEST_FILE, check_most

_HEADER = 128  # bytes; the last two give the byte order
_MATRIX, _COMPRESSED, _LAST = 14, 15, 18  # types of elements; valid are 1 to the last
_NUMBERS = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13))
_TEXT = frozenset((1, 2, 3, 4, 5, 6, 7, 16, 17, 18))
# Valid types of the first three elements of an array: flags, dimensions, name.
_FIRST = ((6,), (5, 6), (1, 16))
_CHAR, _SPARSE, _HIGHEST = 4, 5, 15  # classes; 6 to the highest are dense numbers
_COMPLEX = 0x800
_DEEPEST = 32  # nesting levels of structs and cells


def check_elements(path: Path) -> None:
    """Check all elements of a file; a file of version 4 has none."""
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
                _check_array(memoryview(data), order, str(path), int(kind == _MATRIX))


def _check_array(data: memoryview, order: str, source: str, depth: int) -> None:
    """Check the elements of an array, and those of arrays in it."""
    kinds: list[int] = []
    at, flags = 0, 0
    while at + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, at)
        room = 8 + -(-length // 8) * 8
        if kind >> 16:  # small element: the upper half of its type is its length
            kind, length, room = kind & 0xFFFF, 0, 8
        if not 0 < kind <= _LAST or depth > _DEEPEST:
            raise _damaged(source)
        if kind == _MATRIX:
            _check_array(data[at + 8 : at + 8 + length], order, source, depth + 1)
        elif not kinds and at + 12 <= len(data):
            (flags,) = struct.unpack_from(f"{order}I", data, at + 8)
        kinds.append(kind)
        at += room
    if depth and kinds and not _holds_numbers(kinds, flags):
        raise _damaged(source)


def _holds_numbers(kinds: list[int], flags: int) -> bool:
    """Tell whether an array has the elements that its class needs, of valid types."""
    kind, own = flags & 0xFF, kinds[3:]
    if not _CHAR <= kind <= _HIGHEST:
        return True
    parts = (3 if kind == _SPARSE else 1) + bool(flags & _COMPLEX)
    valid = _TEXT if kind == _CHAR else _NUMBERS
    first = all(x in types for x, types in zip(kinds, _FIRST, strict=False))
    return first and len(own) >= parts and valid.issuperset(own)


def _damaged(source: str) -> RecordingError:
    return RecordingError(
        f"{source}: not a whole MATLAB file: an element is not of its type"
    )
