"""Check the heaps of an HDF5 file: the library would hang on a damaged one.

Text of any length lies in global heaps, object after object until the heap's end. The
library goes on by the size that each states, and one of no size never ends (HDF5 2.0).

Source: HDF5 File Format Specification, version 3.0, section III.E.
"""

from __future__ import annotations

import mmap
import re
import struct
from pathlib import Path

from hybrid.errors import RecordingError

_HEAP = re.compile(rb"GCOL\x01\0\0\0")
_HEADER = 16  # bytes: of a heap, and of an object in it


def check_heaps(path: Path) -> None:
    """Walk every heap as the HDF5 library does.

    Raises:
        RecordingError: An object in a heap has no size.
    """
    with (
        path.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
    ):
        for heap in _HEAP.finditer(data):
            start = at = heap.start()
            size = int.from_bytes(data[at + 8 : at + _HEADER], "little")
            end, room = min(start + size, len(data)), _HEADER
            while room >= _HEADER and (at := at + room) + _HEADER <= end:
                index, _, length = struct.unpack_from("<HH4xQ", data, at)
                # What is free counts its header; an object does not, and is padded.
                room = length if index == 0 else _HEADER + -(-length // 8) * 8
            if room < _HEADER:
                raise RecordingError(
                    f"{path}: not a whole HDF5 file: a heap at byte {start} is damaged"
                )
