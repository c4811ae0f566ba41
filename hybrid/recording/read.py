"""Files, folders and globs -> recordings."""

from __future__ import annotations

import glob
import warnings
from collections.abc import Callable, Iterable, Iterator
from collections.abc import Mapping as MappingType
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording.decide import Decision, decide, decide_command
from hybrid.recording.formats import FOLDERS, READERS, STREAMED, kind_of
from hybrid.recording.formats.frame import table_of_frame
from hybrid.recording.formats.ros import read_ros
from hybrid.recording.mapping import Mapping, read_mapping
from hybrid.recording.reading import Used
from hybrid.recording.recording import Recording
from hybrid.recording.streams import main_stream
from hybrid.recording.table import LARGEST_FILE, LogTable, NoJointsError
from hybrid.recording.units import seconds

Map = str | Path | MappingType[str, Any] | Mapping | None


def read(
    path: str | Path,
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Recording:
    """Read one recording.

    Args:
        path: File of a kind in ``READERS``, or the folder of a bag or a dataset.
        joints: Joint names of the robot, base to tip: columns by name are put in this
            order, columns by number get these names. None keeps the file's.
        map: Which column is which channel: a YAML file, its content as a dict, or the
            name of a preset. None leaves it to the labels and the file's format.
        torque: Refuse a log without torques.
        progress: Told now and then how far a large bag is read.

    Raises:
        RecordingError: The file is missing, of an unknown kind, or not a valid log.

    Warns:
        HybridWarning: Columns were set aside.
    """
    path = Path(path)
    logs = list(_logs(_opened(path), progress))
    if len(logs) != 1:
        names = [tables[0].name for tables in logs]
        raise RecordingError(
            f"{path}: {len(logs)} recordings ({', '.join(names[:6])}"
            f"{' ...' if len(names) > 6 else ''}) where one is asked for; valid is a "
            "file of one"
        )
    return recording_of(logs[0], joints=joints, map=map, torque=torque)


def read_all(
    paths: str | Path | Iterable[str | Path],
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
    progress: Callable[[str], None] | None = None,
) -> list[Recording]:
    """Read all recordings of files, folders and globs.

    Args:
        paths: One or more of: a file; a folder, for all recordings in it; the folder of
            a ROS 2 bag or of a LeRobot dataset; a glob. Folders and globs give their
            files in alphabetical order.
        joints: As in :func:`read`.
        map: As in :func:`read`.
        torque: As in :func:`read`.
        progress: As in :func:`read`.

    Raises:
        RecordingError: A path holds no recording, or one is not valid.

    Warns:
        HybridWarning: Columns were set aside, or files of a folder that hold no joint.
    """
    if isinstance(paths, (str, Path)):
        paths = [paths]
    found = _all_files(paths)
    mapping, recordings = read_mapping(map), []
    for file, single in found.items():
        try:
            logs = _logs(_opened(file), progress)
            recordings += [
                recording_of(log, joints=joints, map=mapping, torque=torque)
                for log in logs
            ]
        except NoJointsError as error:
            if single:
                raise
            warnings.warn(f"left out: {error}", HybridWarning, stacklevel=2)
    if not recordings:
        raise RecordingError(f"{next(iter(found)).parent}: no file there holds joints")
    return recordings


def recording_from_table(
    table: Any,
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
) -> Recording:
    """The recording of a pandas, polars or pyarrow table, or a dict of arrays.

    Args:
        table: Table with named columns; labels, joints and units are told as in
            files, an index of dates or of name ``time`` is a column.
        joints: Joint names of the robot, base to tip; None if not known.
        map: As in :func:`read`.
        torque: Refuse a table without torques.

    Raises:
        RecordingError: It is no table, or no valid log.

    Warns:
        HybridWarning: Columns were set aside.
    """
    tables = (table_of_frame(table),)
    return recording_of(tables, joints=joints, map=map, torque=torque)


def recording_of(
    tables: tuple[LogTable, ...],
    *,
    joints: tuple[str, ...] | None = None,
    map: Map = None,
    torque: bool = True,
) -> Recording:
    """Build the recording of a log's tables.

    Args:
        tables: The log's streams, each on its own clock.
        joints: As in :func:`read`.
        map: As in :func:`read`.
        torque: As in :func:`read`.

    Raises:
        RecordingError: The samples are not a valid recording.
    """
    mapping = read_mapping(map)
    tables = tuple(x for x in tables if x.name == mapping.topic) or tables
    if len(tables) == 1:
        decision = decide(tables[0], joints=joints, mapping=mapping, torque=torque)
        return _recording(tables[0], decision, torque)

    def decided(table: LogTable, quiet: bool) -> Decision:
        return decide(table, joints=joints, mapping=mapping, torque=torque, quiet=quiet)

    def commanded(table: LogTable, joints: tuple[str, ...]) -> Decision | None:
        return decide_command(table, joints, mapping)

    def built(table: LogTable, decision: Decision) -> Recording:
        return _recording(table, decision, torque)

    return main_stream(tables, decided, built, commanded)


def _recording(table: LogTable, decision: Decision, torque: bool) -> Recording:
    reading, time = decision.reading, decision.time
    clock, channels = _samples(table, decision)
    if time.index < 0:  # no clock, but a rate
        t, unit = clock * time.factor, "s"
    else:
        t, unit = seconds(clock, time.unit)
    time = replace(time, unit=unit, stated=time.stated or unit != "s")
    used, notes = [time], list(reading.notes)
    for channel, group in decision.channels.items():
        x = channels[channel]
        # How ROS says that something was not measured.
        if channel != "q" and x.size and np.isnan(x).all():
            notes.append(f"{channel} holds no number")
            del channels[channel]
            continue
        used += group
    if torque and "tau" not in channels:
        raise RecordingError(f"{table.place}: no torques: tau holds no number")
    reading = replace(reading, columns=tuple(used), notes=tuple(notes))
    return Recording(
        t=t,
        joints=decision.joints,
        source=table.source,
        reading=reading,
        **channels,  # type: ignore[arg-type]
    )


def _samples(
    table: LogTable, decision: Decision
) -> tuple[NDArray[Any], dict[str, Array]]:
    """The clock as in the file, shape (N,), and channels in SI, shape (N, n).

    Where a map gives a rate in place of a clock, rows are counted.
    """
    columns = (u.index for u in decision.reading.columns if u.index >= 0)
    blocks = table.load(tuple(dict.fromkeys(columns)))
    sizes = [next(iter(block.values())).size for block in blocks]
    channels = {
        name: np.empty((sum(sizes), len(group)))
        for name, group in decision.channels.items()
    }
    clocks, at, time = [np.arange(sum(sizes), dtype=float)], 0, decision.time
    if time.index >= 0:
        clocks = [block[time.index] for block in blocks]
        for clock in clocks:
            _check_numbers(clock, time, table)
    for size in sizes:
        block = blocks.pop(0)  # and nobody holds it any more
        for name, group in decision.channels.items():
            _fill(channels[name][at : at + size], block, group, table)
        at += size
    return np.concatenate(clocks), channels


def _fill(
    values: Array,
    block: dict[int, NDArray[Any]],
    used: tuple[Used, ...],
    table: LogTable,
) -> None:
    """Put a block's samples of a channel, in SI, into their rows, shape (N, n)."""
    for k, u in enumerate(used):
        x = block[u.index]
        _check_numbers(x, u, table)
        if len(x) != len(values):
            raise RecordingError(
                f"{table.place}: {u.channel}{k + 1} ({u.joint}) has {len(x)} rows; "
                f"valid are {len(values)}, as many as there are times"
            )
        values[:, k] = x
        if u.factor != 1.0:
            values[:, k] *= u.factor
        if u.offset:
            values[:, k] += u.offset


def _check_numbers(x: NDArray[Any], used: Used, table: LogTable) -> None:
    kinds = "fiuM" if used.channel == "t" else "fiu"
    if x.ndim != 1 or x.dtype.kind not in kinds:
        raise RecordingError(
            f"{table.place}: {used.label} has shape {x.shape} and type {x.dtype}; "
            "valid are numbers, (N,) or (N, n)"
        )


def _opened(path: Path) -> Path:
    """The path, if a reader may have it."""
    if path.is_dir():
        if kind_of(path) is None:
            raise RecordingError(
                f"{path}: is a folder, and neither a bag nor a dataset; valid are "
                f"these and files of {', '.join(READERS)}"
            )
        return path
    if kind_of(path) is None:
        raise RecordingError(
            f"{path}: unknown kind of recording; valid are {', '.join(READERS)}"
        )
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if (size := path.stat().st_size) > LARGEST_FILE and kind_of(path) not in STREAMED:
        raise RecordingError(
            f"{path}: {size:.3g} bytes; valid are {LARGEST_FILE:.3g} or less"
        )
    return path


def _logs(
    path: Path, progress: Callable[[str], None] | None
) -> Iterator[tuple[LogTable, ...]]:
    """The tables of each recording of a file or folder."""
    kind = kind_of(path) or ""
    reader = FOLDERS.get(kind) or READERS[kind]
    if reader is read_ros and progress is not None:
        tell = progress

        def told(done: int, total: int) -> None:
            tell(f"reading {path.name}: {done:,} of {total:,} messages")

        return iter(read_ros(path, tell=told))
    return iter(reader(path))


def _all_files(paths: Iterable[str | Path]) -> dict[Path, bool]:
    """Files of all paths, each once, and whether it was asked for by itself."""
    found: dict[Path, bool] = {}
    for path in paths:
        for file, single in _files(Path(path)):
            found[file] = single or found.get(file, False)
    if not found:
        raise RecordingError("no paths given; valid are files, folders and globs")
    return found


def _files(path: Path) -> list[tuple[Path, bool]]:
    """Files of a path, each with whether it was asked for by itself."""
    if path.is_file() or kind_of(path) in FOLDERS:
        return [(path, True)]
    if path.is_dir():
        candidates = sorted(path.iterdir())
    else:
        candidates = [Path(name) for name in sorted(glob.glob(str(path)))]
    found = [
        file
        for file in candidates
        # a name that starts with a dot is a file still being written
        if kind_of(file) and file.name[0] != "." and (file.is_file() or file.is_dir())
    ]
    if not found:
        raise RecordingError(
            f"{path}: no recordings there; valid are files, folders and globs of "
            f"{', '.join(READERS)}"
        )
    return [(file, len(found) == 1) for file in found]
