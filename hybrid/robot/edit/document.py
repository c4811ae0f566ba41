"""Edit single tags in the XML of a robot file; all other bytes stay unchanged."""

from __future__ import annotations

import html
import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from hybrid.errors import RobotError
from hybrid.robot.edit.markup import markup, read_markup
from hybrid.robot.mujoco_model import compile_spec
from hybrid.robot.read import urdf_content
from hybrid.robot.robot import Robot

_VALUE = r"""(\s+{}\s*=\s*)("[^"]*"|'[^']*')"""


@dataclass(frozen=True, eq=False)
class Tag:
    """An element of the file.

    Attributes:
        path: Names of its ancestors, outermost first, and its own name.
        parent: The element around it; None for the outermost.
        place: Place of its start tag in the pieces of the document.
        attributes: Attributes in the file, as text.
    """

    path: tuple[str, ...]
    parent: Tag | None
    place: int
    attributes: dict[str, str]


class Document:
    """A robot file that is edited.

    It is cut into pieces: a text, a tag, what is inserted after the tag, and so on. An
    element without content has an end tag without letters.

    Args:
        content: Content of the file.
        where: The file, for messages.
    """

    def __init__(self, content: bytes, where: str | Path) -> None:
        self.content, self.where = content, where
        self.tags: list[Tag] = []
        self._pieces: list[str] = []
        self._ends: dict[Tag, int] = {}  # place of the end tag of each element
        text, at = read_markup(content), 0
        opened: list[Tag] = []
        for x in markup(text, where):
            self._pieces += [text[at : x.start], text[x.start : x.end], ""]
            at, place = x.end, len(self._pieces) - 2
            if not x.closes:
                around = opened[-1] if opened else None
                path = (*(around.path if around else ()), x.name)
                self.tags.append(Tag(path, around, place, x.attributes))
                opened.append(self.tags[-1])
                self._pieces += ["", "", ""] if x.empty else []
            elif not opened or opened[-1].path[-1] != x.name:
                raise RobotError(
                    f"{where}: not readable XML (</{x.name}> closes no element)"
                )
            if x.closes or x.empty:
                self._ends[opened.pop()] = len(self._pieces) - 2
        self._pieces.append(text[at:])
        if opened or not self.tags:
            raise RobotError(f"{where}: not readable XML (it ends too early)")

    @classmethod
    def load(cls, path: str | Path) -> Document:
        """Read a file. A xacro file is expanded, and each ``include`` replaced."""
        path = Path(path)
        if path.suffix.lower() == ".xacro":
            return cls(urdf_content(path), path)
        return cls(_with_included(path, path.parent, ()), path)

    @property
    def root(self) -> Tag:
        """The outermost element."""
        return self.tags[0]

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
        return [x for x in self.tags if x.parent is tag and name in ("", x.path[-1])]

    def set(
        self,
        tag: Tag,
        given: Mapping[str, Any],
        *,
        drop: Iterable[str] = (),
        name: str = "",
    ) -> None:
        """Set attributes of an element, drop some, and rename it if a name is given."""
        text = self._pieces[tag.place]
        new = {key: text_of(x) for key, x in given.items()}
        for key, value in (dict.fromkeys(drop) | new).items():
            found = re.search(_VALUE.format(re.escape(key)), text)
            if found is not None:
                word = "" if value is None else f'{found[1]}"{value}"'
                text = text[: found.start()] + word + text[found.end() :]
            elif value is not None:
                body = text.removesuffix(">").removesuffix("/").rstrip()
                text = f'{body} {key}="{value}"{text[len(body) :]}'
        if name:
            text = re.sub(r"^<[^\s/>]+", f"<{name}", text)
            if self._pieces[self._ends[tag]]:
                self._pieces[self._ends[tag]] = f"</{name}>"
        self._pieces[tag.place] = text

    def set_child(
        self, tag: Tag, name: str, given: Mapping[str, Any], *, drop: Iterable[str] = ()
    ) -> None:
        """Set attributes of the last child of a name, or insert one with them."""
        own = self.children(tag, name)
        if own:
            self.set(own[-1], given, drop=drop)
        else:
            self.insert_child(tag, element(name, given))

    def replace(self, tag: Tag, text: str) -> None:
        """Replace an element with its content."""
        self._pieces[tag.place] = text
        for place in range(tag.place + 1, self._ends[tag] + 1):
            self._pieces[place] = ""

    def insert_before(self, tag: Tag, text: str) -> None:
        """Insert text before an element."""
        self._pieces[tag.place - 1] += text

    def append(self, text: str) -> None:
        """Insert an element as the last one of the outermost."""
        self._pieces[self._ends[self.root] - 1] += f"  {text}\n"

    def insert_child(self, tag: Tag, text: str) -> None:
        """Insert an element as the first child of another."""
        if not self._pieces[self._ends[tag]]:
            head = self._pieces[tag.place].removesuffix("/>").rstrip()
            self._pieces[tag.place] = f"{head}>"
            self._pieces[self._ends[tag]] = f"</{tag.path[-1]}>"
        if self.children(tag):
            indent = re.findall(r"\n[ \t]*", self._pieces[tag.place + 2])
            text = (indent[0] if indent else "") + text
        self._pieces[tag.place + 1] += text

    def insert_after(self, tag: Tag, text: str) -> None:
        """Insert an element after another."""
        line = "".join(self._pieces[: tag.place]).rpartition("\n")[2]
        indent = line[: len(line) - len(line.lstrip())]
        self._pieces[self._ends[tag] + 1] += f"\n{indent}{text}"

    def inside(self, tag: Tag) -> str:
        """Content of an element."""
        return "".join(self._pieces[tag.place + 1 : self._ends[tag]]).strip()

    def edited(self) -> bytes:
        """Content of the file with all changes."""
        return "".join(self._pieces).encode("utf-8", "surrogateescape")


def model_of(document: Document, robot: Robot) -> Any:
    """Compile the document in the folder of the arm's file."""
    return compile_spec(spec_of(document, robot), robot.path)[0]


def spec_of(document: Document, robot: Robot) -> Any:
    """Parse the document as a MuJoCo spec, in the folder of the arm's file."""
    try:
        spec = mujoco.MjSpec.from_string(document.edited().decode())
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise RobotError(f"{robot.path}: cannot be edited ({reason})") from error
    spec.modelfiledir = str(Path(robot.path).parent)
    return spec


def joint_tag(document: Document, name: str) -> Tag:
    """Find the element of a joint."""
    for tag in document.find("joint", name=name):
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
    document = Document(content, path)
    for tag in document.tags:
        if tag.path[-1] == "include" and "file" in tag.attributes:
            file = home / tag.attributes["file"]
            inner = Document(_with_included(file, home, (*around, path)), file)
            document.replace(tag, inner.inside(inner.root))
    return document.edited()
