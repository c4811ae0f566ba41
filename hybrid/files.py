"""Write outputs whole or not at all; limit the size of inputs before parsing them."""

import ctypes
import errno
import fcntl
import json
import os
import shutil
import uuid
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hybrid.errors import HybridError

MOST_BYTES = 64 * 2**20  # largest JSON file that is read
_MOST_YAML = 100_000  # bytes; the YAML parser takes a second for these
_DEEPEST = 32  # nesting levels of lists and tables


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path, and rename it to ``path`` if no exception occurs.

    On an exception the temporary file is removed and the old file stays unchanged.
    Missing parent folders are created. A link stays, and what it leads to is replaced.

    Raises:
        OSError: The path is a folder, a device or a pipe.
    """
    if fault := output_fault(path):
        raise OSError(errno.EINVAL, fault, str(path))
    given, path = path, Path(path).resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.{uuid.uuid4().hex[:12]}{path.suffix}")
    try:
        yield temporary
        _sync(temporary)
        os.replace(temporary, path)
        _sync(path.parent)
    except OSError as error:
        if error.errno is not None:  # a full disk names no file
            error.filename = str(given)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def output_fault(path: str | Path) -> str:
    """Say why a file cannot take the place of a path; empty if it can."""
    path = Path(path)
    if path.exists() and not path.is_file():
        kind = "folder" if path.is_dir() else "device or pipe"
        return f"is a {kind}; valid is the name of a file"
    return ""


@contextmanager
def atomic_folder(
    folder: str | Path, finish: Callable[[Path, Path], None] | None = None
) -> Iterator[Path]:
    """Yield a hidden folder, and let it replace ``folder`` if no exception occurs.

    Files of the old folder that have other names are kept. A reader finds either all
    old or all new files, also after a crash. If a folder cannot be moved (the current
    folder, a mount point, a folder with subfolders or without write access to its
    parent), its files are replaced one by one. ``finish`` is called with the old and
    the hidden folder before the exchange, while other users of this function wait.
    """
    folder = Path(folder).resolve()
    parent = folder.parent if not folder.is_dir() or _is_movable(folder) else folder
    parent.mkdir(parents=True, exist_ok=True)
    hidden = parent / f".{folder.name[:48]}.{uuid.uuid4().hex[:12]}"
    hidden.mkdir()
    try:
        yield hidden
        with _locked(folder.parent):
            if finish is not None:
                finish(folder, hidden)
            _replace(folder, hidden)
    finally:
        shutil.rmtree(hidden, ignore_errors=True)


def write_json(path: str | Path, content: Any) -> None:
    """Write a JSON file as a whole.

    Raises:
        ValueError: The content holds NaN or infinity, which JSON does not have.
        TypeError: The content holds a type that JSON does not have.
    """
    text = json.dumps(content, allow_nan=False, ensure_ascii=False, indent=2)
    with atomic_path(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def read_json(path: str | Path) -> Any:
    """Read a JSON file.

    Raises:
        OSError: The file cannot be read.
        ValueError: It is too large, nested too deep, or not JSON.
    """
    text = _text(path, MOST_BYTES)
    try:
        content = json.loads(text, parse_constant=_refuse_constant)
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


def read_yaml(path: str | Path, kind: type[HybridError] = HybridError) -> Any:
    """Read a YAML file that has no references (anchors and aliases).

    Raises:
        HybridError: The file cannot be read, is too large, nested too deep, not plain
            YAML, or has a key twice. The error is of the ``kind``.
    """
    import yaml

    try:
        text, depth = _text(path, _MOST_YAML), 0
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth > _DEEPEST or isinstance(event, yaml.AliasEvent):
                raise ValueError(f"has references, or more than {_DEEPEST} levels")
        _check_keys(yaml.compose(text, Loader=yaml.SafeLoader))
        return yaml.safe_load(text)
    except (OSError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = " ".join(str(error).split())
        raise kind(f"{path}: not a readable YAML file ({reason})") from error


def checked_table(
    content: Any,
    keys: Collection[str],
    where: str,
    kind: type[HybridError] = HybridError,
) -> dict[str, Any]:
    """A table of a user's file, if all its keys are known.

    Raises:
        HybridError: It is no table, or has another key. The error is of the ``kind``.
    """
    valid = f"valid are keys {', '.join(keys)}"
    if not isinstance(content, Mapping):
        found = "empty" if content is None else f"{content!r:.80}"
        raise kind(f"{where}: is {found}, not a table; {valid}")
    if unknown := [str(key) for key in content if key not in keys]:
        raise kind(f"{where}: unknown {', '.join(map(repr, unknown))}; {valid}")
    return dict(content)


def _check_keys(node: Any) -> None:
    """Refuse a YAML node in which a key is there twice."""
    if node is None or isinstance(node.value, str):
        return
    if node.id == "mapping":
        count = Counter((x.tag, x.value) for x, _ in node.value if x.id == "scalar")
        if twice := [key for (_, key), n in count.items() if n > 1]:
            raise ValueError(f"has the key {twice[0]!r} twice; valid is once")
    for x in node.value:
        for part in x if isinstance(x, tuple) else (x,):
            _check_keys(part)


def _text(path: str | Path, most: int) -> str:
    """Read a file of at most so many bytes."""
    size = Path(path).stat().st_size
    if size > most:
        raise ValueError(f"{size:,} bytes; valid are up to {most:,}")
    return Path(path).read_bytes().decode("utf-8")


def _refuse_constant(word: str) -> None:
    raise ValueError(f"{word} is not a number of JSON")


def _replace(folder: Path, hidden: Path) -> None:
    """Replace a folder by a finished one, in one step wherever that is possible."""
    for path in hidden.iterdir():
        _sync(path)
    if folder.is_dir() and not (_is_movable(folder) and hidden.parent == folder.parent):
        for path in sorted(hidden.iterdir()):
            os.replace(path, folder / path.name)
        _sync(folder)
        return
    if folder.is_dir():
        _keep_other_files(folder, hidden)
        _sync(hidden)
        if not _exchanged(hidden, folder):
            old = hidden.with_name(f"{hidden.name}.old")
            os.rename(folder, old)
            os.rename(hidden, folder)
            shutil.rmtree(old, ignore_errors=True)
    else:
        _sync(hidden)
        os.rename(hidden, folder)
    _sync(folder.parent)


def _is_movable(folder: Path) -> bool:
    """Tell whether another folder can take the name of this one."""
    return (
        not os.path.ismount(folder)
        and folder not in (Path.cwd(), *Path.cwd().parents)
        and os.access(folder.parent, os.W_OK | os.X_OK)
        and not any(x.is_dir() and not x.is_symlink() for x in folder.iterdir())
    )


def _keep_other_files(old: Path, new: Path) -> None:
    """Link the files that only the old folder has into the new one."""
    shutil.copymode(old, new)
    for path in old.iterdir():
        if not os.path.lexists(new / path.name):
            try:
                os.link(path, new / path.name, follow_symlinks=False)
            except OSError:  # the disk has no links
                shutil.copy2(path, new / path.name, follow_symlinks=False)


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two folders by Linux's renameat2; return whether it worked."""
    here, exchange = -100, 2
    with suppress(AttributeError, OSError):
        rename = ctypes.CDLL(None).renameat2
        done = rename(here, os.fsencode(one), here, os.fsencode(other), exchange)
        return bool(done == 0)
    return False


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Lock a folder against other processes; the lock ends with the process."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a disk on a network may have no locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _sync(path: Path) -> None:
    """Write a file or folder from the cache to the disk."""
    if path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
