"""Outputs appear whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


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
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(folder: str | Path) -> Iterator[Path]:
    """A hidden folder whose files take their places when all went well.

    On any exception it is removed, and what was there before stays as it was. Files of
    other names in a folder that exists are left alone.

    Args:
        folder: Where the finished files shall be.

    Yields:
        Where to write them, on the same disk, so that each move is one step.
    """
    folder = Path(folder).resolve()
    is_new = not folder.is_dir()
    home = folder.parent if is_new else folder
    home.mkdir(parents=True, exist_ok=True)
    hidden = home / f".{folder.name}.{uuid.uuid4().hex[:12]}"
    hidden.mkdir()
    try:
        yield hidden
        if is_new:
            hidden.replace(folder)
        else:
            for path in sorted(hidden.iterdir()):
                path.replace(folder / path.name)
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
