"""Find the byte offset of each number in serialised ROS messages.

The layout follows from the definitions in the bag, which are data and never become
code. Messages of the same length, list lengths and texts have the same layout, so that
thousands are decoded at once.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import AnyArray, Index, Mask

Path = tuple[str | int, ...]

_SIZES = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1",
    "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8",
    "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_TIME: tuple[Any, Any] = (
    [],
    [("sec", (1, ("int32", 0))), ("nanosec", (1, ("uint32", 0)))],
)
MESSAGE, LIST = 2, 4  # kinds of nodes of a definition; an array is 3, the rest is 1
_DEEPEST = 12  # nesting levels of messages
MOST_NUMBERS = 1 << 20  # in a message


class LayoutError(Exception):
    """A message does not fit its definition."""


@dataclass(frozen=True)
class MessageLayout:
    """Offsets of the numbers in a message.

    Attributes:
        length: Length of the message in bytes.
        numbers: Offset and type of each number by its path.
        texts: Each text by its path.
        fixed: Offsets of the bytes that are no numbers, shape (m,).
        shared: These bytes, equal in all messages of this layout, shape (m,).
    """

    length: int
    numbers: dict[Path, tuple[int, np.dtype[Any]]]
    texts: dict[Path, str]
    fixed: Index
    shared: NDArray[np.uint8]

    def fits(self, messages: NDArray[np.uint8]) -> Mask:
        """Tell which messages, shape (N, length), have this layout, shape (N,)."""
        return np.asarray((messages[:, self.fixed] == self.shared).all(axis=1))

    def values(self, messages: NDArray[np.uint8], path: Path) -> AnyArray:
        """One number of each message, shape (N,)."""
        start, kind = self.numbers[path]
        own = np.ascontiguousarray(messages[:, start : start + kind.itemsize])
        return own.view(kind)[:, 0]


def layout_of(
    raw: bytes, kind: str, types: dict[str, Any], *, ros2: bool
) -> MessageLayout:
    """Find the layout of one message by definitions as ``rosbags.typesys`` parses them.

    In ROS 2, four bytes of encoding stand before the message, and numbers are aligned.
    """
    walk = _Walk(raw, types, ros2)
    try:
        walk.message(kind, (), 0)
    except ValueError as error:
        raise LayoutError(f"not a whole {kind}: {error}") from error
    varies = np.zeros(len(raw), dtype=bool)
    for start, dtype in walk.numbers.values():
        varies[start : start + dtype.itemsize] = True
    fixed = np.flatnonzero(~varies)
    shared = np.frombuffer(raw, np.uint8)[fixed]
    return MessageLayout(len(raw), walk.numbers, walk.texts, fixed, shared)


class _Walk:
    """One pass through a message, which collects its numbers and texts."""

    def __init__(self, raw: bytes, types: dict[str, Any], ros2: bool) -> None:
        self.raw, self.types, self.ros2 = raw, types, ros2
        self.at = 4 if ros2 else 0
        self.order: Literal["big", "little"] = "little"
        if ros2 and len(raw) > 1 and raw[1] % 2 == 0:
            self.order = "big"
        self.numbers: dict[Path, tuple[int, np.dtype[Any]]] = {}
        self.texts: dict[Path, str] = {}

    def message(self, kind: str, path: Path, depth: int) -> None:
        definition = self.types.get(kind)
        if definition is None and kind.rsplit("/", 1)[-1] in ("Time", "Duration"):
            definition = _TIME
        if definition is None or depth > _DEEPEST:
            raise LayoutError(f"type {kind} is not defined")
        for name, (node, what) in definition[1]:
            self.field(int(node), what, (*path, name), depth)

    def field(self, node: int, what: Any, path: Path, depth: int) -> None:
        if node == MESSAGE:
            self.message(what, path, depth + 1)
        elif node > MESSAGE:
            (inner, element), count = what
            count = self.length() if node == LIST else count
            if count > min(MOST_NUMBERS, len(self.raw)):
                raise LayoutError(f"{count} numbers in {path[-1]}")
            for k in range(count):
                self.field(int(inner), element, (*path, k), depth)
        elif what[0] == "string":
            text = self.taken(self.length())
            self.texts[path] = text.rstrip(b"\0").decode("utf-8")
        elif what[0] in _SIZES and len(self.numbers) <= MOST_NUMBERS:
            dtype = np.dtype(_SIZES[what[0]]).newbyteorder(self.order)
            self.align(dtype.itemsize)
            self.numbers[path] = (self.at, dtype)
            self.taken(dtype.itemsize)
        else:
            raise LayoutError(f"numbers of type {what[0]}, or too many")

    def taken(self, size: int) -> bytes:
        self.at += size
        if self.at > len(self.raw):
            raise LayoutError("text or number beyond the end")
        return self.raw[self.at - size : self.at]

    def length(self) -> int:
        self.align(4)
        return int.from_bytes(self.taken(4), self.order)

    def align(self, size: int) -> None:
        if self.ros2:
            self.at += -(self.at - 4) % size
