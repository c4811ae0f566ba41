"""Reader of measurements from a CSV file."""

import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hybrid.arrays import Array
from hybrid.calibration.measurements import Measurements
from hybrid.errors import CalibrationError, RecordingError
from hybrid.recording.formats.csv import read_csv

_UNIT = re.compile(r"\s*(?:[\[(]([^\])]*)[\])]|/\s*(m|mm|rad|deg))\s*$")
_SCALE = {
    "": 1.0,
    "m": 1.0,
    "mm": 1e-3,
    "rad": 1.0,
    "deg": np.pi / 180,
    "°": np.pi / 180,
}
_POINT = re.compile(r"([xyz])_?(\d*)")
_DISTANCE = re.compile(r"distance_?(\d*)")
_ORIENTATIONS: dict[tuple[str, ...], Callable[[Array], Rotation]] = {
    ("qx", "qy", "qz", "qw"): Rotation.from_quat,
    ("rx", "ry", "rz"): Rotation.from_rotvec,
    # about fixed x, then y, then z
    ("roll", "pitch", "yaw"): partial(Rotation.from_euler, "xyz"),
}
VALID = (
    "valid are q1 ... or q_<joint>, and x, y, z (x_2, y_2, z_2 for a second reflector "
    "and so on), with qx, qy, qz, qw or rx, ry, rz (rotation vector) or roll, pitch, "
    "yaw where orientation was measured, or distance (distance_2 from a second "
    "station); units in brackets: m, mm, rad, deg"
)


def read_measurements(path: str | Path, joints: Sequence[str]) -> Measurements:
    """Read one line of column names and one line for each pose.

    An empty cell, or nan, means that the value was not measured.

    Args:
        path: File, see :func:`~hybrid.recording.formats.csv.read_csv`.
        joints: Joint names, base to tip.

    Raises:
        CalibrationError: A column is missing, unknown or doubled, or a cell is no
            number; the message names file, column and row.
    """
    columns = _columns(Path(path))
    size = len(next(iter(columns.values())))
    q = np.column_stack([_joint(columns, k, joints, path) for k in range(len(joints))])
    points = _numbered(columns, _POINT)
    stations = _numbered(columns, _DISTANCE)
    position = [np.full((size, 0, 3), np.nan)]
    for number in sorted({n for _, n in points}):
        axes = [points.pop((axis, number), None) for axis in "xyz"]
        if any(axis is None for axis in axes):
            which = "xyz"[[axis is None for axis in axes].index(True)]
            raise CalibrationError(
                f"{path}: no column {which} of point {number}; a point has x, y and z"
            )
        position.append(np.stack([columns.pop(str(x)) for x in axes], 1)[:, None])
    distance = [columns.pop(stations[key]) for key in sorted(stations)]
    rotation = _rotation(columns, path)
    if columns:
        raise CalibrationError(f"{path}: unknown column {', '.join(columns)}; {VALID}")
    if len(position) == 1 and not distance:
        raise CalibrationError(f"{path}: no measured points or distances; {VALID}")
    return Measurements(
        q,
        np.concatenate(position, axis=1),
        rotation,
        np.column_stack(distance) if distance else None,
        str(path),
    )


def _columns(path: Path) -> dict[str, Array]:
    """Columns in SI units by their name in lower case, without the unit."""
    try:
        ((table,),) = read_csv(path)
        cells = table.load(tuple(range(len(table.labels))))[0]
    except RecordingError as error:
        raise CalibrationError(str(error)) from error
    columns: dict[str, Array] = {}
    for k, label in enumerate(table.labels):
        name, scale = _name(label.strip(), path)
        if name in columns:
            raise CalibrationError(f"{path}: two columns {name!r}")
        columns[name] = scale * np.asarray(cells[k], dtype=float)
    return columns


def _name(label: str, path: Path) -> tuple[str, float]:
    match = _UNIT.search(label)
    unit = "".join(filter(None, match.groups())).strip() if match else ""
    if unit not in _SCALE:
        raise CalibrationError(
            f"{path}: column {label!r} is in {unit}; valid are m, mm, rad and deg"
        )
    return (label[: match.start()] if match else label).strip().lower(), _SCALE[unit]


def _joint(
    columns: dict[str, Array], k: int, joints: Sequence[str], path: str | Path
) -> Array:
    name = joints[k].lower()
    for label in (f"q_{name}", f"q{k + 1}", f"q_{k + 1}"):
        if label in columns:
            return columns.pop(label)
    raise CalibrationError(
        f"{path}: no position of joint {joints[k]!r}; valid is a column q{k + 1} or "
        f"q_{joints[k]}"
    )


def _numbered(
    columns: dict[str, Array], pattern: re.Pattern[str]
) -> dict[tuple[str, int], str]:
    """Column names by kind and number; a missing number is 1."""
    found = {}
    for name in columns:
        if match := pattern.fullmatch(name):
            *kind, number = match.groups()
            found["".join(kind), int(number or 1)] = name
    return found


def _rotation(columns: dict[str, Array], path: str | Path) -> Array | None:
    for names, turns in _ORIENTATIONS.items():
        here = [name for name in names if name in columns]
        if not here:
            continue
        if len(here) < len(names):
            raise CalibrationError(
                f"{path}: of an orientation only {', '.join(here)}; valid are "
                f"{', '.join(names)} together"
            )
        values = np.column_stack([columns.pop(name) for name in names])
        seen = np.isfinite(values).all(axis=1)
        if len(names) == 4 and (np.linalg.norm(values[seen], axis=1) < 1e-6).any():
            raise CalibrationError(f"{path}: a quaternion of length zero")
        rotation = np.full((len(values), 3, 3), np.nan)
        rotation[seen] = turns(values[seen]).as_matrix()
        return rotation
    return None
