"""Read MATLAB files: version 5 by SciPy, version 7.3 by h5py."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.arrays import AnyArray
from hybrid.recording.formats.fields import NAMES, table_of_arrays
from hybrid.recording.formats.hdf5 import arrays_of
from hybrid.recording.formats.mat_elements import check_elements
from hybrid.recording.labels import is_time, split_unit
from hybrid.recording.table import LogTable, as_recording_error


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
    names = {k: found[k] for k in NAMES if k in found and found[k].dtype.kind == "U"}
    arrays = _with_rows_as_samples(plain) | names
    return [(table_of_arrays(arrays, str(path), kind="MATLAB"),)]


def _with_rows_as_samples(arrays: dict[str, AnyArray]) -> dict[str, AnyArray]:
    times = [x.size for k, x in arrays.items() if is_time(split_unit(k)[0])]
    rows, found = max(times, default=0), {}
    for name, x in arrays.items():
        if x.ndim == 2 and x.shape[1] == rows != x.shape[0]:
            x = x.T
        found[name] = x[:, 0] if x.ndim == 2 and x.shape[1] == 1 else x
    return found


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
