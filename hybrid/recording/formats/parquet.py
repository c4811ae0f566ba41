"""Read Parquet files, and LeRobot datasets v2 and v3, which consist of them.

A dataset is a folder with ``meta/info.json``, which names the joints. Each episode is a
recording. Datasets state no units, and have torques only if the robot recorded them.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hybrid.errors import RecordingError
from hybrid.extras import check_extra
from hybrid.files import read_json
from hybrid.recording.formats.frame import table_of_frame
from hybrid.recording.table import (
    MOST_COLUMNS,
    LogTable,
    as_recording_error,
    check_most,
)

VERSIONS = ("v2.0", "v2.1", "v3.0")
_MOST_FILES = 100_000
_EPISODE = "episode_index"
_FEATURE = re.compile(r"(.+)\[(\d+)\]")


def is_dataset(folder: Path) -> bool:
    """Tell whether a folder is a LeRobot dataset."""
    return (folder / "meta" / "info.json").is_file()


def read_parquet_or_episodes(path: Path) -> Iterable[tuple[LogTable]]:
    """Read a Parquet file; one of a dataset has its episodes and names of joints.

    One that was copied away from its dataset has its episodes.
    """
    above = path.absolute().parents
    folders = [x for x in above if x / "data" in above and is_dataset(x)]
    if folders:
        return read_lerobot(folders[0], path)
    table = _arrow_table(path)
    if {_EPISODE, "timestamp"} <= {*table.column_names}:
        return ((x,) for x in _episodes(path))
    return [(table_of_frame(table, str(path), kind="Parquet"),)]


def read_lerobot(folder: Path, only: Path | None = None) -> Iterator[tuple[LogTable]]:
    """Read the episodes of a dataset, or of one of its files, one table each."""
    with as_recording_error(folder, "meta/info.json"):
        info = read_json(folder / "meta" / "info.json")
        version, features = str(info["codebase_version"]), dict(info["features"])
    if version not in VERSIONS:
        raise RecordingError(
            f"{folder}: LeRobot dataset {version[:20]}; valid are {', '.join(VERSIONS)}"
        )
    data = folder / "data"
    files = [only] if only else sorted(data.rglob("*.parquet"))[:_MOST_FILES]
    if not files:
        raise RecordingError(f"{folder}: no Parquet files in data/")
    for file in files:
        for episode in _episodes(file):
            labels = tuple(_label(label, features) for label in episode.labels)
            yield (replace(episode, labels=labels, home=str(folder)),)


def _episodes(file: Path) -> Iterator[LogTable]:
    table = _arrow_table(file, ("timestamp", _EPISODE, "observation", "action"))
    table = table.drop_columns([x for x in table.column_names if "image" in x])
    if _EPISODE not in table.column_names or not len(table):
        raise RecordingError(f"{file}: no rows, or no {_EPISODE}")
    index = np.asarray(table[_EPISODE])
    for episode in np.unique(index):
        rows = np.flatnonzero(index == episode)
        part = table.take(rows).drop_columns([_EPISODE])
        yield table_of_frame(
            part, str(file), kind="LeRobot", name=f"episode {episode}", preset="lerobot"
        )


def _label(label: str, features: dict[str, Any]) -> str:
    """Put the joint's name into ``observation.state[0]``, if the dataset has names."""
    match = _FEATURE.fullmatch(label)
    feature = features.get(match.group(1)) if match else None
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):  # {"motors": [...]}
        names = next(iter(names.values()), None)
    if not match or not isinstance(names, list) or len(names) == 1:
        return label
    if (place := int(match.group(2))) >= len(names):
        return label
    name, _, kind = str(names[place]).rpartition(".")
    if not name or kind in ("pos", "position"):
        return f"{match.group(1)}[{name or kind}]"
    return f"{match.group(1)}/{kind}/{name}"


def _arrow_table(path: Path, begin: tuple[str, ...] = ("",)) -> Any:
    """Read the numbers, dates, texts and their lists whose names begin like this."""
    check_extra("pyarrow", "parquet", f"{path}: Parquet")
    from pyarrow import parquet, types

    left_out = types.is_binary, types.is_large_binary, types.is_struct
    with as_recording_error(path, "Parquet file"), parquet.ParquetFile(path) as file:
        names = [
            f.name for f in file.schema_arrow
            if f.name.startswith(begin) and not any(kind(f.type) for kind in left_out)
        ]  # fmt: skip
        check_most(path, len(names), "columns", MOST_COLUMNS)
        check_most(path, 8 * file.metadata.num_rows * len(names), "bytes of numbers")
        return file.read(columns=names)
