"""Bags of ROS 2 (sqlite3, MCAP) and ROS 1: a table for each topic with joints.

Every message that has lists of real numbers is read, whatever its type; a list beside
names has the names in its labels: ``/joint_states/position/elbow``. Time is that of the
header, or of the recorder where headers have none.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hybrid.errors import HybridWarning, RecordingError
from hybrid.names import printable
from hybrid.recording.formats.topic import Topic
from hybrid.recording.table import LARGEST_FILE, LogTable, NoJointsError, whole

_LARGEST_DEFINITION = 200_000  # bytes of text
_MOST_TOPICS = 10_000
TELL_EVERY = 20_000  # messages between two words on the progress


def is_bag(folder: Path) -> bool:
    """Whether a folder is a ROS 2 bag, whose files are all there."""
    listed = folder / "metadata.yaml"
    if not listed.is_file():
        return False
    from hybrid.files import read_yaml

    try:
        content = read_yaml(listed)["rosbag2_bagfile_information"]
        names = [Path(str(x)).name for x in content["relative_file_paths"]]
    except (OSError, ValueError, KeyError, TypeError):
        return False
    return all((folder / name).is_file() for name in names)


def read_ros(
    path: Path, *, tell: Callable[[int, int], None] | None = None
) -> Iterator[tuple[LogTable, ...]]:
    """Read the topics of a bag that have lists of real numbers.

    Args:
        path: Bag of ROS 2 as folder or file, or of ROS 1.
        tell: Called with messages read and messages in all, now and then.

    Raises:
        RecordingError: It is damaged, or rosbags is not installed.
        NoJointsError: It holds no joints; the message says what it holds instead.
    """
    ros2 = path.suffix.lower() != ".bag"
    opened = _reader(path, ros2)
    with whole(path, "bag"):
        _check_chunks(path)
        with opened(path) as reader:
            topics = _topics(reader.connections, ros2, str(path))
            held = _held(reader.connections)
            _fill(reader, topics, tell)
    tables = tuple(table for topic in topics.values() for table in topic.tables())
    if all(table.kind.endswith("JointTrajectory)") for table in tables):
        raise NoJointsError(
            f"{path}: no joint states there; it holds {held or 'no messages'}; valid "
            "is a topic of sensor_msgs/JointState"
        )
    yield tables


def _reader(path: Path, ros2: bool) -> Any:
    """The class of rosbags that reads a bag."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2
    except ImportError as error:
        raise RecordingError(
            f"{path}: a bag is read by rosbags; install it: pip install "
            "'hybrid-arm[ros]'"
        ) from error
    return rosbags.rosbag2.Reader if ros2 else rosbags.rosbag1.Reader


def _held(connections: Any) -> str:
    held = [
        printable(f"{c.topic} ({c.msgtype}, {c.msgcount})")[:200] for c in connections
    ]
    return ", ".join(held[:8]) + (f" and {len(held) - 8} more" if held[8:] else "")


def _topics(connections: Any, ros2: bool, source: str) -> dict[Any, Topic]:
    """The topics to be read, by connection; others may be named in a warning."""
    from rosbags.interfaces import MessageDefinitionFormat as Format
    from rosbags.typesys import (
        Stores,
        get_types_from_idl,
        get_types_from_msg,
        get_typestore,
    )

    if len(connections) > _MOST_TOPICS:
        raise RecordingError(f"{source}: {len(connections)} topics")
    known = get_typestore(Stores.ROS2_JAZZY if ros2 else Stores.ROS1_NOETIC).fielddefs
    topics: dict[Any, Topic] = {}
    for c in connections:
        types = dict(known)
        form, text = c.msgdef.format, c.msgdef.data
        if form != Format.NONE and len(text) <= _LARGEST_DEFINITION:
            try:
                types |= (
                    get_types_from_msg(text, c.msgtype)
                    if form == Format.MSG
                    else get_types_from_idl(_idl(text))
                )
            except RecursionError:
                continue
            except Exception as error:  # a definition is a text like any other
                _warn(source, c.topic, str(error))
                continue
        if _has_lists(c.msgtype, types, 0):
            topics[c.id, id(c.owner)] = Topic(c.topic, c.msgtype, types, ros2, source)
        elif c.msgtype not in types and "msgs/" in c.msgtype:
            _warn(source, c.topic, f"type {c.msgtype} is not defined in the bag")
    return topics


def _idl(text: str) -> str:
    return "\n".join(x for x in text.splitlines() if not x.startswith(("===", "IDL:")))


def _warn(source: str, topic: str, reason: str) -> None:
    line = (reason.splitlines() or [""])[0][:200]
    warnings.warn(
        f"{source}: left out topic {topic}: {line}", HybridWarning, stacklevel=4
    )


def _has_lists(kind: str, types: dict[str, Any], depth: int) -> bool:
    """Whether a type has lists of real numbers, and none of bytes (an image)."""
    if kind not in types or depth > 6:
        return False
    found = False
    for _, (node, what) in types[kind][1]:
        element, inner = int(node), what
        if element > 2:
            inner_node, inner = what[0]
            if element == 4 and int(inner_node) == 1:
                if inner[0] in ("uint8", "int8", "byte", "char"):
                    return False
                found |= inner[0] in ("float64", "float32")
            element = int(inner_node)
        if element == 2:
            found |= _has_lists(inner, types, depth + 1)
    return found


def _fill(reader: Any, topics: dict[Any, Topic], tell: Any) -> None:
    wanted = [c for c in reader.connections if (c.id, id(c.owner)) in topics]
    if not wanted:
        return
    total = sum(c.msgcount for c in wanted)
    for k, (c, stamp, raw) in enumerate(reader.messages(connections=wanted)):
        topics[c.id, id(c.owner)].add(stamp, raw)
        if tell and k % TELL_EVERY == 0:
            tell(k, total)
    for topic in topics.values():
        topic.decode()


def _check_chunks(path: Path) -> None:
    """Refuse a bag of MCAP of which a chunk unpacks to more than any log.

    The size that a chunk declares is checked against what comes out of it, but only
    after it did; zstandard may hold a thousand times what it takes.
    """
    files = [path] if path.is_file() else sorted(path.glob("*.mcap"))
    for file in files:
        if file.suffix.lower() != ".mcap":
            continue
        with file.open("rb") as content:
            size, at = file.stat().st_size, 8
            while at + 9 <= size:
                content.seek(at)
                head = content.read(9 + 28)
                length = int.from_bytes(head[1:9], "little")
                if head[0] == 0x06 and len(head) == 37:
                    declared = int.from_bytes(head[25:33], "little")
                    kind = int.from_bytes(content.read(4), "little")
                    name = content.read(min(kind, 16))
                    if declared > LARGEST_CHUNK:
                        raise RecordingError(
                            f"{file}: a chunk unpacks to {declared:.3g} bytes; valid "
                            f"are {LARGEST_CHUNK:.3g} or less"
                        )
                    packed = int.from_bytes(content.read(8), "little")
                    if name == b"zstd" and packed < size:
                        _check_frame(content.read(18), declared, file)
                at += 9 + length


LARGEST_CHUNK = min(1 << 30, LARGEST_FILE)  # bytes, unpacked


def _check_frame(head: bytes, declared: int, file: Path) -> None:
    """Refuse a zstandard frame of another size than its chunk's (RFC 8878)."""
    if len(head) < 6 or head[:4] != b"\x28\xb5\x2f\xfd":
        return
    flags = head[4]
    single, size_flag = (flags >> 5) & 1, flags >> 6
    width = (1, 2, 4, 8)[size_flag] if size_flag or single else 0
    start = 5 + (0 if single else 1) + (0, 1, 2, 4)[flags & 3]
    size = int.from_bytes(head[start : start + width], "little")
    size += 256 if width == 2 else 0
    if width and size != declared:
        raise RecordingError(
            f"{file}: a chunk of {declared} bytes unpacks to {size:.3g}"
        )
