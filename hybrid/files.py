"""Outputs appear whole or not at all; inputs are measured before they are parsed."""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import shutil
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

MOST_BYTES = 64 * 2**20  # of a JSON file that is read
_MOST_YAML = 100_000  # bytes, whose parser takes a second for these
_DEEPEST = 32  # lists and tables within each other in a file


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path`` that takes its place when all went well.

    On any exception the temporary file is removed and the old file stays as it was.
    The suffix is kept, because some writers choose the format by it. Missing parent
    folders are made.

    Args:
        path: Where the finished file shall be.

    Yields:
        Where to write it, in the same folder, so that the move is one step.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:12]}{path.suffix}")
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync(path.parent)
    except OSError as error:
        if error.errno is not None:  # and words: a full disk names no file
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(
    folder: str | Path, finish: Callable[[Path, Path], None] | None = None
) -> Iterator[Path]:
    """A hidden folder that takes the place of ``folder`` when all went well.

    Files of other names in a folder that exists go along. A reader finds either what
    was there or what was written, and so does whoever comes after a crash. A folder
    that cannot be moved (the current one, a mount point, one with folders in it or in a
    folder that cannot be written) stays, and its files are replaced one by one.

    Args:
        folder: Where the finished files shall be.
        finish: Called with the folder as it is and the hidden one before they change
            places, while no other process puts files into the former.

    Yields:
        Where to write them, on the same disk.
    """
    folder = Path(folder).resolve()
    home = folder.parent if not folder.is_dir() or _moves(folder) else folder
    home.mkdir(parents=True, exist_ok=True)
    hidden = home / f".{folder.name[:48]}.{uuid.uuid4().hex[:12]}"
    hidden.mkdir()
    try:
        yield hidden
        with _locked(folder.parent):
            if finish is not None:
                finish(folder, hidden)
            _put(hidden, folder)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def write_json(path: str | Path, content: Any) -> None:
    """Write JSON in one step; NaN and infinity are refused, they are not JSON.

    Args:
        path: Where the file shall be.
        content: Anything the json module can write.

    Raises:
        ValueError: The content holds NaN or infinity.
        TypeError: The content holds something JSON has no word for.
    """
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Content of a JSON file of sensible size.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is too large, nested too deep, or not JSON.
    """
    path = Path(path)
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"{size:,} bytes; valid are up to {MOST_BYTES:,}")
    try:
        content = json.loads(path.read_bytes().decode("utf-8"), parse_constant=_refuse)
    except RecursionError as error:
        raise ValueError(f"nested deeper than {_DEEPEST} levels") from error
    level = [content]
    for _ in range(_DEEPEST):
        lists = [x.values() if isinstance(x, dict) else x for x in level
                 if isinstance(x, (dict, list))]  # fmt: skip
        level = [x for each in lists for x in each]
    if level:
        raise ValueError(f"nested deeper than {_DEEPEST} levels")
    return content


def read_yaml(path: str | Path) -> Any:
    """Content of a YAML file of sensible size, without references within it.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is too large, nested too deep, or not plain YAML.
    """
    import yaml

    path = Path(path)
    size = path.stat().st_size
    if size > _MOST_YAML:
        raise ValueError(f"{size:,} bytes; valid are up to {_MOST_YAML:,}")
    text, depth = path.read_bytes().decode("utf-8"), 0
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST or isinstance(event, yaml.AliasEvent):
                raise ValueError(f"has references, or more than {_DEEPEST} levels")
        return yaml.safe_load(text)
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError(" ".join(str(error).split())) from error


def _refuse(word: str) -> None:
    raise ValueError(f"{word} is not a number of JSON")


def _put(hidden: Path, folder: Path) -> None:
    """Let a finished folder take its place, in one step wherever that can be done."""
    for path in hidden.iterdir():
        _sync(path)
    if folder.is_dir() and not (_moves(folder) and hidden.parent == folder.parent):
        for path in sorted(hidden.iterdir()):
            os.replace(path, folder / path.name)
        _sync(folder)
        return
    if folder.is_dir():
        _take_along(folder, hidden)
        _sync(hidden)
        if not _exchanged(hidden, folder):
            aside = hidden.with_name(f"{hidden.name}.old")
            os.rename(folder, aside)
            os.rename(hidden, folder)
            shutil.rmtree(aside, ignore_errors=True)
    else:
        _sync(hidden)
        os.rename(hidden, folder)
    _sync(folder.parent)


def _moves(folder: Path) -> bool:
    """Whether a folder may be replaced by another without anybody missing it."""
    return (
        not os.path.ismount(folder)
        and folder not in (Path.cwd(), *Path.cwd().parents)
        and os.access(folder.parent, os.W_OK | os.X_OK)
        and not any(x.is_dir() and not x.is_symlink() for x in folder.iterdir())
    )


def _take_along(old: Path, new: Path) -> None:
    """Put the files that are only in the old folder into the new one as well."""
    shutil.copymode(old, new)
    for path in old.iterdir():
        if not os.path.lexists(new / path.name):
            try:
                os.link(path, new / path.name, follow_symlinks=False)
            except OSError:  # a disk without links
                shutil.copy2(path, new / path.name, follow_symlinks=False)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders in one step, if the system can; Linux's renameat2 does."""
    here, exchange = -100, 2
    with suppress(AttributeError, OSError):
        rename = ctypes.CDLL(None).renameat2
        done = rename(here, os.fsencode(one), here, os.fsencode(other), exchange)
        return bool(done == 0)
    return False


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One process at a time; the lock goes with its holder, and leaves nothing."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a disk on a network may have no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _sync(path: Path) -> None:
    """Have the disk hold what was written, before a name points to it."""
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
