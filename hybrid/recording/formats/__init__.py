"""Readers of file formats, one module each: they turn a path into tables."""

from collections.abc import Callable, Iterable
from pathlib import Path

from hybrid.recording.formats.csv import read_csv
from hybrid.recording.formats.hdf5 import read_hdf5
from hybrid.recording.formats.mat import read_mat
from hybrid.recording.formats.npz import read_npz
from hybrid.recording.formats.parquet import (
    is_dataset,
    read_lerobot,
    read_parquet_or_episodes,
)
from hybrid.recording.formats.ros import is_bag, read_ros
from hybrid.recording.table import LogTable

Reader = Callable[[Path], Iterable[tuple[LogTable, ...]]]

READERS: dict[str, Reader] = {
    ".csv": read_csv,
    ".tsv": read_csv,
    ".csv.gz": read_csv,
    ".tsv.gz": read_csv,
    ".parquet": read_parquet_or_episodes,
    ".npz": read_npz,
    ".mcap": read_ros,
    ".db3": read_ros,
    ".bag": read_ros,
    ".h5": read_hdf5,
    ".hdf5": read_hdf5,
    ".mat": read_mat,
}
FOLDERS: dict[str, Reader] = {"ROS 2 bag": read_ros, "LeRobot": read_lerobot}
STREAMED = (".mcap", ".db3", ".bag", *FOLDERS)  # of any size


def kind_of(path: Path) -> str | None:
    """Key of ``READERS`` or ``FOLDERS`` for a path; None if it is no recording."""
    if path.is_dir():
        if is_dataset(path):
            return "LeRobot"
        return "ROS 2 bag" if is_bag(path) else None
    name = path.name.lower()
    return next((suffix for suffix in READERS if name.endswith(suffix)), None)
