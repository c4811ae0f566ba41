"""Edit single tags in the XML of a robot file; all other bytes stay unchanged."""

from __future__ import annotations

import html
import os
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.mujoco_model import compile_spec
from hybrid.robot.robot import Robot

_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_VALUE = r"""(\s+{}\s*=\s*)("[^"]*"|'[^']*')"""


@dataclass(frozen=True)
class Tag:
    """An element of the file; positions are in bytes.

    Attributes:
        path: Names of its ancestors, outermost first, and its own name.
        parents: Positions of the start tags of its ancestors.
        start: Start of its start tag.
        end: End of its start tag.
        close: Start of its end tag; ``end`` if it has none.
        after: End of the element.
        attributes: Attributes as text.
    """

    path: tuple[str, ...]
    parents: tuple[int, ...]
    start: int
    end: int
    close: int
    after: int
    attributes: dict[str, str]


class Document:
    """A robot file that is edited.

    Args:
        content: Content of the file.
        where: The file, for messages.
    """

    def __init__(self, content: bytes, where: str | Path) -> None:
        self.content, self.where = content, where
        self.tags = list(tags(content, where))
        self._renamed: dict[int, str] = {}
        self._set: dict[int, dict[str, str | None]] = {}
        self._replaced: list[tuple[int, int, str]] = []  # start, end, new text

    @classmethod
    def load(cls, path: str | Path) -> Document:
        """Read a file, and replace each ``include`` by the included content."""
        path = Path(path)
        return cls(_with_included(path, path.parent, ()), path)

    def find(self, *path: str, **attributes: str) -> list[Tag]:
        """Elements whose path ends with ``path``, and that have these attributes."""
        return [
            tag
            for tag in self.tags
            if tag.path[-len(path) :] == path
            and attributes.items() <= tag.attributes.items()
        ]

    def children(self, tag: Tag, name: str = "") -> list[Tag]:
        """Children of an element: those of a name, or all."""
        return [
            t for t in self.tags if t.parents[-1:] == (tag.start,)
            and (not name or t.path[-1] == name)
        ]  # fmt: skip

    def set(
        self,
        tag: Tag,
        given: Mapping[str, Any],
        *,
        drop: Iterable[str] = (),
        name: str = "",
    ) -> None:
        """Set attributes of an element, drop some, and rename it if a name is given."""
        own = self._set.setdefault(tag.start, {})
        own |= dict.fromkeys(drop) | {key: text_of(x) for key, x in given.items()}
        if name:
            self._renamed[tag.start] = name

    def insert(self, at: int, text: str) -> None:
        """Insert text before the byte ``at``."""
        self._replaced.append((at, at, text))

    def replace(self, tag: Tag, text: str) -> None:
        """Replace an element with its content."""
        self._replaced.append((tag.start, tag.after, text))

    def insert_child(self, tag: Tag, text: str) -> None:
        """Insert an element as the first child of another."""
        children = self.children(tag)
        if children:
            gap = self.content[tag.end : children[0].start].decode(errors="replace")
            indent = re.findall(r"\n[ \t]*", gap)
            text = (indent[0] if indent else "") + text
        self.insert(tag.end, text)

    def insert_after(self, tag: Tag, text: str) -> None:
        """Insert an element after another."""
        line = self.content[: tag.start].rpartition(b"\n")[2]
        indent = line[: len(line) - len(line.lstrip())].decode()
        self.insert(tag.after, f"\n{indent}{text}")

    def edited(self) -> bytes:
        """Content of the file with all changes."""
        edits = list(self._replaced)
        for tag in self.tags:
            if tag.start in self._set:
                edits.append((tag.start, tag.end, self._changed(tag)))
            if tag.start in self._renamed and tag.close > tag.end:
                closing = f"</{self._renamed[tag.start]}>"
                edits.append((tag.close, tag.after, closing))
        content = self.content
        # Texts at the same position keep the order of their insertion.
        for start, end, text in sorted(reversed(edits), key=lambda x: -x[0]):
            content = content[:start] + text.encode() + content[end:]
        return content

    def _changed(self, tag: Tag) -> str:
        text = self.content[tag.start : tag.end].decode()
        for key, value in self._set[tag.start].items():
            found = re.search(_VALUE.format(re.escape(key)), text)
            if found is not None:
                word = "" if value is None else f'{found[1]}"{value}"'
                text = text[: found.start()] + word + text[found.end() :]
            elif value is not None:
                body = text.removesuffix(">").removesuffix("/").rstrip()
                text = f'{body} {key}="{value}"{text[len(body) :]}'
        old, new = tag.path[-1], self._renamed.get(tag.start, tag.path[-1])
        return f"<{new}{text.removeprefix(f'<{old}')}"


def model_of(document: Document, robot: Robot) -> Any:
    """Compile the document in the folder of the arm's file."""
    return compile_spec(spec_of(document, robot), robot.path)[0]


def spec_of(document: Document, robot: Robot) -> Any:
    """Parse the document as a MuJoCo spec, in the folder of the arm's file."""
    import mujoco

    try:
        spec = mujoco.MjSpec.from_string(document.edited().decode())
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{robot.path}: cannot be edited ({reason})") from error
    spec.modelfiledir = str(Path(robot.path).parent)
    return spec


def joint_tag(document: Document, name: str) -> Tag:
    """Find the element of a joint."""
    for kind in ("joint", "freejoint"):
        for tag in document.find(kind, name=name):
            if "worldbody" in tag.path:
                return tag
    raise RobotError(
        f"{document.where}: joint {name!r} is not in the file; valid are joints with "
        "names, outside of replicate and attach"
    )


def text_of(value: Any) -> str:
    """Text of an attribute; numbers read back exactly."""
    if isinstance(value, str):
        return html.escape(value)
    if isinstance(value, int):
        return str(value)
    return " ".join(repr(float(x)) for x in np.atleast_1d(value))


def element(name: str, given: Mapping[str, Any]) -> str:
    """Text of an element without content."""
    words = "".join(f' {key}="{text_of(x)}"' for key, x in given.items())
    return f"<{name}{words}/>"


def relative_path(file: str, home: Path, folder: Path) -> str:
    """Convert a path relative to the folder ``home`` to one relative to ``folder``."""
    if not file or os.path.isabs(file) or "://" in file:
        return file
    return Path(os.path.relpath(home / file, folder)).as_posix()


def tags(content: bytes, path: str | Path) -> Iterator[Tag]:
    """Elements in the order of the file; prefixes need not be declared."""
    opened: list[tuple[tuple[str, ...], tuple[int, ...], int, int, dict[str, str]]] = []
    closed: dict[int, tuple[int, int]] = {}
    names: list[str] = []
    starts: list[int] = []
    parser = expat.ParserCreate()

    def end_of(start: int) -> int:
        match = _TAG.match(content, start)
        assert match is not None  # expat has just read it
        return match.end()

    def open_tag(name: str, attributes: dict[str, str]) -> None:
        start = parser.CurrentByteIndex
        names.append(name)
        end = end_of(start)
        opened.append((tuple(names), tuple(starts), start, end, dict(attributes)))
        starts.append(start)

    def close_tag(_: str) -> None:
        names.pop()
        start, at = starts.pop(), parser.CurrentByteIndex
        end = end_of(start)
        empty = content[end - 2 : end] == b"/>"
        closed[start] = (end, end) if empty else (at, end_of(at))

    parser.StartElementHandler, parser.EndElementHandler = open_tag, close_tag
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise RobotError(f"{path}: not readable XML ({error})") from error
    for own, parents, start, end, attributes in opened:
        yield Tag(own, parents, start, end, *closed[start], attributes)


def _with_included(path: Path, home: Path, around: tuple[Path, ...]) -> bytes:
    """Content of a file and of the files that it includes, relative to ``home``."""
    if path in around:
        raise RobotError(f"{path}: includes itself")
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror})") from error
    if b"<include" not in content:
        return content
    for tag in reversed(list(tags(content, path))):
        if tag.path[-1] != "include" or "file" not in tag.attributes:
            continue
        file = home / tag.attributes["file"]
        inner = _with_included(file, home, (*around, path))
        root = next(tags(inner, file))
        inside = inner[root.end : root.close].strip()
        content = content[: tag.start] + inside + content[tag.after :]
    return content
