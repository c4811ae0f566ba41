"""Read recordings from files, folders, globs and tables in memory."""

import glob
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hybrid.arguments import typed
from hybrid.errors import RecordingError, warn
from hybrid.progress import Progress
from hybrid.recording.build import recording_of
from hybrid.recording.formats import FOLDERS, READERS, STREAMED, kind_of
from hybrid.recording.formats.frame import table_of_frame
from hybrid.recording.formats.ros import read_ros
from hybrid.recording.mapping import Map, read_mapping
from hybrid.recording.recording import Recording
from hybrid.recording.table import LogTable, NoJointsError, check_most


@typed
def read(path: str | Path, **options: Any) -> Recording:
    """Read the only recording of a file or folder; options as in :func:`read_all`.

    Raises:
        RecordingError: The file is missing, of an unknown kind, not a valid log, or
            holds several recordings.
    """
    logs = list(_logs(Path(path), options.pop("progress", None)))
    if len(logs) != 1:
        names = [tables[0].name for tables in logs]
        raise RecordingError(
            f"{path}: {len(logs)} recordings ({', '.join(names[:6])}"
            f"{' ...' if len(names) > 6 else ''}) where one is asked for; valid is a "
            "file of one"
        )
    return recording_of(logs[0], **options)


@typed
def read_all(
    paths: str | Path | Iterable[str | Path],
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
    progress: Progress | None = None,
) -> list[Recording]:
    """Read all recordings of files, folders and globs.

    Args:
        paths: One or more of: a file; a folder, for all recordings in it; the folder of
            a ROS 2 bag or of a LeRobot dataset; a glob. Files of folders and globs are
            read in alphabetical order.
        joints: Joint names of the robot, base to tip. Named columns are put in this
            order; numbered columns get these names. None keeps the file's names.
        map: Map of columns to channels: a YAML file, its content as a dict, or the name
            of a preset. By default labels and format decide.
        torque: Refuse a log without torques.
        progress: Called with a message while a large bag is read.

    Raises:
        RecordingError: A path holds no recording, or one is not valid.

    Warns:
        HybridWarning: Columns were not used, or files without joints were left out.
    """
    found: dict[Path, bool] = {}
    for path in [paths] if isinstance(paths, (str, Path)) else paths:
        for file, single in _files(Path(path)):
            found[file] = single or found.get(file, False)
    if not found:
        raise RecordingError("no paths given; valid are files, folders and globs")
    mapping = read_mapping(map)
    recordings, left = list[Recording](), list[NoJointsError]()
    for file, single in found.items():
        try:
            for log in _logs(file, progress):
                # Alike files of a folder share a warning.
                home = "" if single else str(file.parent)
                tables = tuple(replace(x, home=x.home or home) for x in log)
                recordings.append(
                    recording_of(tables, joints=joints, map=mapping, torque=torque)
                )
        except NoJointsError as error:
            if single:
                raise
            left.append(error)
    for why in left:
        warn(f"left out: {why}")
    if not recordings:
        raise RecordingError(f"{next(iter(found)).parent}: no file there holds joints")
    return recordings


@typed
def recording_from_table(
    table: Any,
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
) -> Recording:
    """Turn a pandas, polars or pyarrow table, or a dict of arrays, into a recording.

    Args:
        table: Table with named columns, whose labels are those of files. An index of
            dates, or one named ``time``, is a column, too.
        joints: Joint names of the robot, base to tip; None if not known.
        map: As in :func:`hybrid.read_recordings`.
        torque: Refuse a table without torques.

    Raises:
        RecordingError: It is no table, or no valid log.

    Warns:
        HybridWarning: Columns were not used.
    """
    tables = (table_of_frame(table),)
    return recording_of(tables, joints=joints, map=map, torque=torque)


def _logs(path: Path, progress: Progress | None) -> Iterable[tuple[LogTable, ...]]:
    """Tables of each recording of a file or folder."""
    kind, what = kind_of(path), "unknown kind of recording"
    if kind is None:
        if path.is_dir():
            what = "is a folder, and neither a bag nor a dataset"
        raise RecordingError(f"{path}: {what}; valid are {', '.join(READERS)}")
    if not path.exists():
        raise RecordingError(f"{path}: no such file")
    if kind not in STREAMED:
        check_most(path, path.stat().st_size, "bytes")
    reader = (READERS | FOLDERS)[kind]
    return read_ros(path, progress) if reader is read_ros else reader(path)


def _files(path: Path) -> list[tuple[Path, bool]]:
    """Files of a path, and whether each is the only one."""
    if path.is_file() or kind_of(path) in FOLDERS:
        return [(path, True)]
    if path.exists() and not path.is_dir():
        raise RecordingError(f"{path}: a pipe or a device; valid are files")
    inside = sorted(path.iterdir()) if path.is_dir() else [
        Path(name) for name in sorted(glob.glob(str(path)))]  # fmt: skip
    found = [
        file
        for file in inside
        # a name that starts with a dot belongs to an unfinished file
        if kind_of(file) and file.name[0] != "." and (file.is_file() or file.is_dir())
    ]
    if not found:
        raise RecordingError(
            f"{path}: no recordings there; valid are files, folders and globs of "
            f"{', '.join(READERS)}"
        )
    return [(file, len(found) == 1) for file in found]
