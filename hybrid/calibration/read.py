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
_DEGREE = np.pi / 180
_SCALE = {"": 1.0, "m": 1.0, "mm": 1e-3, "rad": 1.0, "deg": _DEGREE, "°": _DEGREE}
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
    q = np.column_stack([_joint(columns, k, joints, path) for k in range(len(joints))])
    points, stations = _numbered(columns, _POINT), _numbered(columns, _DISTANCE)
    seen = []
    for number in sorted({n for _, n in points}):
        for axis in "xyz":
            if (axis, number) not in points:
                raise CalibrationError(
                    f"{path}: no column {axis} of point {number}; a point has x, y "
                    "and z"
                )
            seen.append(columns.pop(points[axis, number]))
    position = np.reshape(seen, (-1, 3, len(q))).transpose(2, 0, 1)
    distance = [columns.pop(stations[key]) for key in sorted(stations)]
    rotation = _rotation(columns, path)
    if columns:
        raise CalibrationError(f"{path}: unknown column {', '.join(columns)}; {VALID}")
    if not (seen or distance):
        raise CalibrationError(f"{path}: no measured points or distances; {VALID}")
    distances = np.column_stack(distance) if distance else None
    return Measurements(q, position, rotation, distances, str(path))


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
    name, *units = _UNIT.split(label)
    unit = "".join(filter(None, units)).strip()
    if unit not in _SCALE:
        raise CalibrationError(
            f"{path}: column {label!r} is in {unit}; valid are m, mm, rad and deg"
        )
    return name.strip().lower(), _SCALE[unit]


def _joint(
    columns: dict[str, Array], k: int, joints: Sequence[str], path: str | Path
) -> Array:
    for label in (f"q_{joints[k].lower()}", f"q{k + 1}", f"q_{k + 1}"):
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
