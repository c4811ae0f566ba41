"""Read bags of ROS 2 (sqlite3, MCAP) and ROS 1: a table for each topic with joints.

Messages of any type are read if they have lists of real numbers. If a message also has
a list of names, labels use them: ``/joint_states/position/elbow``. Time is that of the
header, or that of the recorder if headers have none.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hybrid.errors import HybridError, warn
from hybrid.files import read_yaml
from hybrid.names import printable
from hybrid.progress import Progress
from hybrid.recording.formats.cdr import LIST, MESSAGE
from hybrid.recording.formats.topic import Topic
from hybrid.recording.table import (
    LogTable,
    NoJointsError,
    as_recording_error,
    check_most,
)

_LARGEST_DEFINITION = 200_000  # bytes of text
_DEEPEST = 6  # nesting levels of messages that are searched for lists
_LARGEST_CHUNK = 1 << 30  # bytes, unpacked
_PROGRESS_STEP = 20_000  # messages between two progress messages


def is_bag(folder: Path) -> bool:
    """Tell whether a folder is a ROS 2 bag with all its files."""
    try:
        content = read_yaml(folder / "metadata.yaml")["rosbag2_bagfile_information"]
        names = [Path(str(x)).name for x in content["relative_file_paths"]]
    except (HybridError, KeyError, TypeError):
        return False
    return all((folder / name).is_file() for name in names)


def read_ros(
    path: Path, progress: Progress | None = None
) -> Iterator[tuple[LogTable, ...]]:
    """Read the topics of a bag that have lists of real numbers."""
    from rosbags import rosbag1, rosbag2

    ros2 = path.suffix.lower() != ".bag"
    with as_recording_error(path, "bag"):
        for file in [path] if path.is_file() else sorted(path.glob("*.mcap")):
            if file.suffix.lower() == ".mcap":
                _check_chunks(file)
        with (rosbag2 if ros2 else rosbag1).Reader(path) as reader:
            topics = _topics(reader.connections, ros2, str(path))
            held = [printable(f"{c.topic} ({c.msgtype}, {c.msgcount})")[:200]
                    for c in reader.connections]  # fmt: skip
            _fill(reader, topics, path.name, progress)
    tables = tuple(table for topic in topics.values() for table in topic.tables())
    if all(table.kind.endswith("JointTrajectory)") for table in tables):
        more = f" and {len(held) - 8} more" if held[8:] else ""
        raise NoJointsError(
            f"{path}: no joint states there; it holds "
            f"{', '.join(held[:8]) or 'no messages'}{more}; valid "
            "is a topic of sensor_msgs/JointState"
        )
    yield tables


def _topics(connections: Any, ros2: bool, source: str) -> dict[Any, Topic]:
    """Topics to be read, by connection; warn of those with an unknown type."""
    from rosbags.typesys import Stores, get_typestore

    check_most(source, len(connections), "topics", 10_000)
    known = get_typestore(Stores.ROS2_JAZZY if ros2 else Stores.ROS1_NOETIC).fielddefs
    topics: dict[Any, Topic] = {}
    for c in connections:
        try:
            types = {**known, **_defined(c)}
            if c.msgtype not in types and "msgs/" in c.msgtype:
                raise ValueError(f"type {c.msgtype} is not defined in the bag")
        except RecursionError:
            continue
        except Exception as error:  # the parser raises any type for a wrong text
            line = (str(error).splitlines() or [""])[0][:200]
            warn(f"{source}: left out topic {c.topic}: {line}")
            continue
        if _has_lists(c.msgtype, types, 0):
            topics[c.id, id(c.owner)] = Topic(c.topic, c.msgtype, types, ros2, source)
    return topics


def _defined(connection: Any) -> dict[str, Any]:
    """Message types that the bag defines for a connection."""
    from rosbags.interfaces import MessageDefinitionFormat as Format
    from rosbags.typesys import get_types_from_idl, get_types_from_msg

    form, text = connection.msgdef.format, connection.msgdef.data
    if form == Format.NONE or len(text) > _LARGEST_DEFINITION:
        return {}
    if form == Format.MSG:
        return get_types_from_msg(text, connection.msgtype)
    lines = (x for x in text.splitlines() if not x.startswith(("===", "IDL:")))
    return get_types_from_idl("\n".join(lines))


def _has_lists(kind: str, types: dict[str, Any], depth: int) -> bool:
    """Tell whether a type has lists of real numbers, but none of bytes (an image)."""
    if kind not in types or depth > _DEEPEST:
        return False
    found = False
    for _, (node, what) in types[kind][1]:
        inner, of = what[0] if node > MESSAGE else (node, what)
        if node == LIST and inner < MESSAGE:
            if of[0] in ("uint8", "int8", "byte", "char"):
                return False
            found |= of[0] in ("float64", "float32")
        if inner == MESSAGE:
            found |= _has_lists(of, types, depth + 1)
    return found


def _fill(reader: Any, topics: dict[Any, Topic], name: str, progress: Any) -> None:
    wanted = [c for c in reader.connections if (c.id, id(c.owner)) in topics]
    if not wanted:
        return
    total = sum(c.msgcount for c in wanted)
    for k, (c, stamp, raw) in enumerate(reader.messages(connections=wanted)):
        topics[c.id, id(c.owner)].add(stamp, raw)
        if progress and k % _PROGRESS_STEP == 0:
            progress(f"reading {name}: {k:,} of {total:,} messages", k / total)
    for topic in topics.values():
        topic.decode()


def _check_chunks(file: Path) -> None:
    """Refuse an MCAP bag with a chunk that unpacks to more than 1 GiB.

    The reader checks the declared size only after unpacking, and zstandard can unpack
    to a thousand times the packed size.
    """
    size, at = file.stat().st_size, 8
    with file.open("rb") as content:
        while at + 9 <= size:
            content.seek(at)
            head = content.read(128)
            if head[0] == 0x06:  # a chunk; packed data follows the compression's name
                packed = head[49 + _number(head[37:41]) :]
                unpacked = max(_number(head[25:33]), _frame_size(packed))
                check_most(file, unpacked, "bytes of a chunk, unpacked", _LARGEST_CHUNK)
            at += 9 + _number(head[1:9])


def _number(data: bytes) -> int:
    return int.from_bytes(data, "little")


def _frame_size(head: bytes) -> int:
    """Unpacked size of a zstandard frame in bytes (RFC 8878); 0 if not stated."""
    if len(head) < 6 or head[:4] != b"\x28\xb5\x2f\xfd":
        return 0
    flags = head[4]
    single = flags >> 5 & 1
    width = (single, 2, 4, 8)[flags >> 6]
    start = 6 - single + (0, 1, 2, 4)[flags & 3]
    return _number(head[start : start + width]) + 256 * (width == 2)
