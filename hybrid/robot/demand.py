"""Estimate the memory and time that a robot file needs, before it is compiled.

A few bytes of MJCF can describe a billion bodies. The text is read once, tag by tag.
The parsers of MuJoCo and URDF also accept what is not valid XML; so does this one. It
counts elements, times the copies that ``replicate`` and others make of them, and the
numbers that textures, height fields and user data need.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hybrid.errors import RobotError
from hybrid.names import printable

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
_TAG = re.compile(r"""<\s*(/?)\s*([^\s<>/"'=]+)((?:[^<>"']|"[^"]*"|'[^']*')*+)>""")
_SKIPPED = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<![^>]*>", re.DOTALL)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*("[^"]*"|'[^']*')""")


@dataclass
class _Demand:
    """Demand of a file and of the files that it includes."""

    elements: float = 0.0
    numbers: float = 0.0
    attached: float = 0.0  # number of models that are attached
    models: list[str] = field(default_factory=list)
    files: list[str] = field(default_factory=list)
    folders: list[str] = field(default_factory=lambda: [""])


def check_demand(path: Path) -> None:
    """Refuse a robot file that needs more than any robot does."""
    try:
        _demand(path, path.parent, [])
    except OSError as error:
        where = error.filename or path
        raise RobotError(f"{where}: cannot be read ({error.strerror})") from error


def _demand(path: Path, home: Path, seen: list[Path]) -> _Demand:
    """Demand of a file; names in it are relative to the folder ``home``."""
    seen.append(path)
    _check(path, "files", len(seen))
    _check(path, "bytes", path.stat().st_size)
    found = _Demand()
    opened: list[float] = []  # copies of each open element
    for closes, tag, given in _tags(path):
        if closes:
            del opened[-1:]
            continue
        copies = opened[-1] if opened else 1.0
        if tag in _COPIES:
            copies *= _product(given.get("count", ""))
        _check_sizes(path, given)
        _add(found, tag, given, copies)
        if tag == "include":
            _merge(found, _included(given.get("file", ""), path, home, seen), copies)
        _check(path, "elements", found.elements)
        _check(path, "numbers", found.numbers)
        if "/" not in given:
            opened.append(copies)
            _check(path, "levels", len(opened))
    for name in found.models if found.attached else ():
        _merge(found, _included(name, path, home, seen), found.attached)
    _check_files(path, home, found)
    _check(path, "elements", found.elements)
    return found


def _add(found: _Demand, tag: str, given: Mapping[str, str], copies: float) -> None:
    found.elements += copies
    own = [x for name, x in given.items() if _NUMBERS.fullmatch(name)]
    own += [given.get("size", "")] if tag == "numeric" else []
    found.numbers += copies * math.prod(map(_product, own)) if own else 0.0
    found.attached += copies if tag == "attach" else 0.0
    if tag == "model":
        found.models.append(given.get("file", ""))
    elif tag != "include":
        found.files += [x for name, x in given.items() if name.startswith("file")]
    found.folders += [x for name, x in given.items() if name.endswith("dir")]


def _check_sizes(path: Path, given: Mapping[str, str]) -> None:
    for name, most in _MOST_OF.items():
        if name in given and _product(given[name]) > most:
            shown = printable(given[name][:40])
            raise RobotError(f"{path}: {name} is {shown}; valid is up to {most:,.0f}")


def _merge(found: _Demand, other: _Demand, copies: float) -> None:
    found.elements += copies * other.elements
    found.numbers += copies * other.numbers
    found.attached += copies * other.attached
    found.models += other.models
    found.files += other.files
    found.folders += other.folders


def _included(name: str, path: Path, home: Path, seen: list[Path]) -> _Demand:
    """Demand of a file that is named in another one; zero if it does not exist."""
    for folder in (home, path.parent):
        if (folder / name).is_file():
            return _demand(folder / name, home, seen)
    return _Demand()


def _check_files(path: Path, home: Path, found: _Demand) -> None:
    """Check that MuJoCo will open no device or pipe, and not too many bytes."""
    size = 0
    for name in dict.fromkeys(found.files):
        for folder in dict.fromkeys(found.folders):
            file = home / folder / name
            if file.is_file():
                size += file.stat().st_size
            elif file.exists() and not file.is_dir():
                raise RobotError(f"{path}: {printable(name)!r} is not a regular file")
    _check(path, "bytes of its files", size)


def _tags(path: Path) -> Iterator[tuple[bool, str, dict[str, str]]]:
    """Tags in order: whether it is an end tag, its name, its attributes.

    An element without content has an attribute named ``/``.
    """
    text, at = path.read_bytes().decode("latin-1"), 0
    while (at := text.find("<", at)) >= 0:
        match = _SKIPPED.match(text, at) or _TAG.match(text, at)
        if match is None:
            raise RobotError(
                f"{path}: not a readable robot file (a tag is not closed, "
                f"{printable(text[at : at + 20])!r})"
            )
        if match.re is _TAG:
            closing, tag, rest = match.groups()
            given = {k: x[1:-1] for k, x in _ATTRIBUTE.findall(rest)}
            if rest.endswith("/"):
                given["/"] = ""
            yield bool(closing), tag, given
        at = match.end()


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
