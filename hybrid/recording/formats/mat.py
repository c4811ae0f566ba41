"""MATLAB files: version 5 by SciPy, version 7.3 by h5py; variables, or one struct."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.recording.formats.fields import NAMES, table_of_arrays
from hybrid.recording.formats.hdf5 import arrays_of
from hybrid.recording.formats.mat_elements import check_elements
from hybrid.recording.table import LogTable, whole
from hybrid.recording.words import is_time, split_unit


def read_mat(path: Path) -> list[tuple[LogTable]]:
    """The variables of a file, or the fields of its struct.

    Raises:
        RecordingError: It is damaged, or a library that reads it is not installed.
    """
    with path.open("rb") as file:
        head = file.read(128)
    with whole(path, "MATLAB file"):
        if head[:10] == b"MATLAB 7.3":  # whose columns are rows to HDF5
            found = {k.replace("/", "."): x.T for k, x in arrays_of(path)[0].items()
                     if k[0] != "#"}  # fmt: skip
        else:
            found = _old(path)
    structs = {name.split(".")[0] for name in found if "." in name}
    if len(structs) == 1:  # fields of the only one go by their own names
        found = {name.split(".", 1)[-1]: x for name, x in found.items()}
    plain = {k: x for k, x in found.items() if x.dtype.kind in "fiu" and x.ndim < 3}
    names = {k: found[k] for k in NAMES if k in found and found[k].dtype.kind == "U"}
    return [(table_of_arrays(_upright(plain) | names, str(path), kind="MATLAB"),)]


def _upright(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Transpose arrays so that rows are samples."""
    times = [x.size for k, x in arrays.items() if is_time(split_unit(k)[0])]
    rows, found = max(times, default=0), {}
    for name, x in arrays.items():
        if x.ndim == 2 and x.shape[1] == rows != x.shape[0]:
            x = x.T
        one = x.ndim == 2 and x.shape[1] == 1
        found[name] = x[:, 0] if one else x
    return found


def _old(path: Path) -> dict[str, NDArray[Any]]:
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of variables that it cannot read
        check_elements(path)
        content = scipy.io.loadmat(path, squeeze_me=False, chars_as_strings=True)
    found: dict[str, NDArray[Any]] = {}
    for name, x in content.items():
        if name.startswith("__"):
            continue
        if isinstance(x, np.ndarray) and x.dtype.names and x.size == 1:
            found |= {f"{name}.{k}": _plain(x[k].item()) for k in x.dtype.names}
        else:
            found[name] = _plain(x)
    return found


def _plain(x: Any) -> NDArray[Any]:
    """An array; cells of texts become texts."""
    plain: NDArray[Any] = np.asarray(x)
    cells = [np.asarray(v) for v in plain.ravel()] if plain.dtype == object else []
    if cells and all(v.dtype.kind == "U" and v.size for v in cells):
        return np.array([str(v.ravel()[0]) for v in cells])
    return plain
