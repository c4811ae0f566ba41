"""Read HDF5 files: one recording, or one in each group (robomimic's demos)."""

import json
import mmap
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.extras import check_extra
from hybrid.recording.formats.fields import NAMES, table_of_arrays
from hybrid.recording.labels import is_time, parse_label, split_unit
from hybrid.recording.table import (
    LogTable,
    NoJointsError,
    as_recording_error,
    check_most,
)

_HEAP = re.compile(rb"GCOL\x01\0\0\0")
_HEADER = 16  # bytes of a heap, and of an object in it
_EPISODE = re.compile(
    r"(.*/)?(demo|episode|ep|trajectory|traj|run)_?\d+", re.IGNORECASE
)


def read_hdf5(path: Path) -> list[tuple[LogTable]]:
    """Read the arrays of a file, or of each group that is named like an episode."""
    arrays, rate = arrays_of(path)
    groups: dict[str, dict[str, AnyArray]] = {}
    for name, x in arrays.items():
        episode = match.group() if (match := _EPISODE.match(name)) else ""
        groups.setdefault(episode, {})[name[len(episode) :].strip("/")] = x
    logs = [
        (_table(group, episode, str(path), rate),)
        for episode, group in sorted(groups.items(), key=lambda x: _natural(x[0]))
        if any(parse_label(split_unit(label)[0]).channel == "q" or label == "joints"
               for label in group) or len(groups) == 1
    ]  # fmt: skip
    if not logs:
        held = ", ".join(list(arrays)[:8])
        raise NoJointsError(f"{path}: no joint positions among {held or 'no arrays'}")
    return logs


def arrays_of(path: Path) -> tuple[dict[str, AnyArray], float]:
    """Read all arrays of a file by path, and the rate that robomimic states, [Hz].

    The unit of an attribute is added to the label.
    """
    check_extra("h5py", "hdf5", f"{path}: HDF5")
    import h5py

    found: dict[str, AnyArray] = {}
    seen, size = 0, 0

    def visit(name: str, item: Any) -> None:
        nonlocal seen, size
        seen += 1
        check_most(path, seen, "groups and arrays", 20_000)
        check_most(path, name.count("/"), "levels of groups", 16)
        if _is_read(item):
            size += item.size * item.dtype.itemsize
            check_most(path, size, "bytes of arrays")
            found[_label_with_unit(name, item)] = item[()]

    with as_recording_error(path, "HDF5 file"):
        _check_heaps(path)
        with h5py.File(path, "r") as file:
            file.visititems(visit)  # follows no links to other files
            return found, _rate(file)


def _natural(name: str) -> tuple[str, int]:
    start = re.sub(r"\d+$", "", name)
    return start, int(name[len(start) :] or 0)


def _table(
    group: dict[str, AnyArray], episode: str, source: str, rate: float
) -> LogTable:
    numbers = {k: x for k, x in group.items() if x.dtype.kind in "fiu"}
    if rate > 0 and not any(is_time(split_unit(label)[0]) for label in numbers):
        numbers["time"] = np.arange(max(map(len, numbers.values()), default=0)) / rate
    numbers |= {k: group[k] for k in NAMES if k in group}
    return table_of_arrays(numbers, source, kind="HDF5", name=episode)


def _is_read(item: Any) -> bool:
    """Tell whether it is an array that may be a column, and lies in this file."""
    shape = getattr(item, "shape", None)  # neither groups nor empty arrays have one
    if shape is None or not 0 < len(shape) < 3 or item.dtype.kind not in "fiuSUO":
        return False
    return not (item.external or item.is_virtual)


def _label_with_unit(label: str, item: Any) -> str:
    for key in ("units", "unit"):
        unit = item.attrs.get(key)
        unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
        if isinstance(unit, str) and unit and not split_unit(label)[1]:
            return f"{label} [{unit[:24]}]"
    return label


def _rate(file: Any) -> float:
    """Rate that robomimic states in place of times, [Hz]; 0 if it states none."""
    try:
        text = file["data"].attrs["env_args"]
        content = json.loads(str(text)[:100_000])
        return float(content["env_kwargs"]["control_freq"])
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError):
        return 0.0


def _check_heaps(path: Path) -> None:
    """Check the global heaps of a file: a damaged one lets the HDF5 library hang.

    A heap is a sequence of objects. The library skips each by its stated size, and
    never ends at an object of size 0 (HDF5 2.0).

    Source: HDF5 File Format Specification, version 3.0, section III.E.
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
                # The size of free space includes its header. That of an object does
                # not, and is padded.
                room = length if index == 0 else _HEADER + -(-length // 8) * 8
            if room < _HEADER:
                raise ValueError(f"the heap at byte {start} is damaged")
