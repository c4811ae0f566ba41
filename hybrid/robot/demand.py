"""Estimate the memory and time that a robot file needs, before it is compiled.

A few bytes of MJCF can describe a billion bodies. The text is read once, tag by tag, to
count elements, times the copies that ``replicate`` and others make of them, and the
numbers that textures, height fields and user data need.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hybrid.errors import RobotError
from hybrid.names import printable
from hybrid.robot.edit.markup import markup, read_markup

# MuJoCo's time grows with the square of the elements: this number takes seconds. The
# largest robot file of a usual collection, of a humanoid on wheels, has 3,895 elements.
_MOST = {
    "bytes": 2**26, "levels": 300, "elements": 8_000, "numbers": 30_000_000,
    "files": 100, "bytes of its files": 2**30,
}  # fmt: skip
_MOST_OF = {"nkey": 1e4, "nconmax": 1e6, "njmax": 1e6, "nstack": 1e9, "memory": 2**34}
_COPIES = ("replicate", "composite", "flexcomp")  # ``count`` copies of their content
_NUMBERS = re.compile(r"nrow|ncol|width|height|nsample|nuser\w+|actdim|dim")
_PREFIX = {"k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40, "p": 2**50, "e": 2**60}


@dataclass
class _Demand:
    """Demand of a file and of the files that it names, relative to a folder."""

    home: Path
    elements: float = 0.0
    numbers: float = 0.0
    attached: float = 0.0  # number of models that are attached
    opened: int = 0  # files that were read
    models: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    folders: list[str] = field(default_factory=lambda: [""])

    def read(self, path: Path, copies: float) -> None:
        """Add the elements of a file, times the copies that are made of them."""
        self.opened += 1
        _check(path, "files", self.opened)
        _check(path, "bytes", path.stat().st_size)
        inner = [copies]  # copies of the elements at each level
        for tag in markup(read_markup(path.read_bytes()), path):
            if tag.closes:
                inner = inner[:-1] or inner
                continue
            own, given = inner[-1], tag.attributes
            if tag.name in _COPIES:
                own *= _product(given.get("count", ""))
            self.add(path, tag.name, given, own)
            if tag.name == "include":
                self.read_named(given.get("file", ""), path, own)
            if not tag.empty:
                inner.append(own)
                _check(path, "levels", len(inner) - 1)

    def read_named(self, name: str, path: Path, copies: float) -> None:
        """Add a file that is named in another one, if it exists."""
        for folder in (self.home, path.parent):
            if (folder / name).is_file():
                self.read(folder / name, copies)
                return

    def add(
        self, path: Path, tag: str, given: Mapping[str, str], copies: float
    ) -> None:
        """Add an element."""
        for name, most in _MOST_OF.items():
            if name in given and _product(given[name]) > most:
                shown = printable(given[name][:40])
                raise RobotError(
                    f"{path}: {name} is {shown}; valid is up to {most:,.0f}"
                )
        self.elements += copies
        own = [x for name, x in given.items() if _NUMBERS.fullmatch(name)]
        own += [given.get("size", "")] if tag == "numeric" else []
        self.numbers += copies * math.prod(map(_product, own)) if own else 0.0
        self.attached += copies if tag == "attach" else 0.0
        if tag == "model":
            self.models.append(given.get("file", ""))
        elif tag != "include":
            self.files += [x for name, x in given.items() if name.startswith("file")]
        self.folders += [x for name, x in given.items() if name.endswith("dir")]
        _check(path, "elements", self.elements)
        _check(path, "numbers", self.numbers)


def check_demand(path: Path) -> None:
    """Refuse a robot file that needs more than any robot does."""
    try:
        _demand(path)
    except OSError as error:
        where = error.filename or path
        raise RobotError(f"{where}: cannot be read ({error.strerror})") from error


def _demand(path: Path) -> _Demand:
    found = _Demand(path.parent)
    found.read(path, 1.0)
    for name in found.models:  # grows by the models of models
        if found.attached:
            found.read_named(name, path, found.attached)
    size = 0
    for name in dict.fromkeys(found.files):
        for folder in dict.fromkeys(found.folders):
            file = path.parent / folder / name
            if file.is_file():
                size += file.stat().st_size
            elif file.exists() and not file.is_dir():  # a device or a pipe
                raise RobotError(f"{path}: {printable(name)!r} is not a regular file")
    _check(path, "bytes of its files", size)
    return found


def _product(text: str) -> float:
    """Product of the numbers above 1 in a text; ``2K`` is 2048."""
    found = 1.0
    for word in text.split():
        scale = _PREFIX.get(word[-1].lower(), 1) if word[:-1].isdigit() else 1
        try:
            number = abs(float(word[:-1] if scale > 1 else word))
        except ValueError:
            number = 1.0
        found *= max(number * scale, 1.0)
    return found


def _check(path: Path, what: str, value: float) -> None:
    if value > _MOST[what]:
        raise RobotError(
            f"{path}: asks for {value:,.0f} {what}; valid are up to {_MOST[what]:,}"
        )
