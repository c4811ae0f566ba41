"""Write figures and JSON, whole or not at all; record versions and inputs."""

from __future__ import annotations

import platform
import re
import warnings
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hybrid import __version__
from hybrid.errors import HybridError
from hybrid.files import atomic_path, write_json

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Pixels per inch of PNG files and of point clouds inside SVG files.
RESOLUTION = 150


def figure_bytes(figure: Figure, kind: str = "svg") -> bytes:
    """A figure as a file's content; the same figure gives the same bytes.

    Args:
        figure: Any figure.
        kind: ``svg``, ``png`` or ``pdf``.

    Raises:
        HybridError: There is no such kind.
    """
    # Without a date and with a fixed salt for its ids, a file depends on its data only.
    timeless = {"svg": {"Date": None}, "png": {}, "pdf": {"CreationDate": None}}
    if kind not in timeless:
        raise HybridError(
            f"no figure of kind {kind!r}; valid are {', '.join(timeless)}"
        )
    from matplotlib import rc_context

    target = BytesIO()
    with rc_context({"svg.hashsalt": "hybrid"}), warnings.catch_warnings():
        # A joint may have a name in any script; what the font lacks is a box.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(target, format=kind, dpi=RESOLUTION, metadata=timeless[kind])
    return _palette(target) if kind == "png" else target.getvalue()


def _palette(image: BytesIO) -> bytes:
    """A PNG in 128 colours: figures have few inks, and it is a third of the size."""
    from PIL import Image

    target = BytesIO()
    with Image.open(image) as picture:
        few = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    few.save(target, format="png", optimize=True)
    return target.getvalue()


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure; the suffix, ``.svg``, ``.png`` or ``.pdf``, says which kind.

    Raises:
        HybridError: There is no such kind.
    """
    path = Path(path)
    content = figure_bytes(figure, path.suffix.lstrip(".").lower())
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_results(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write results for other programs; arrays become lists, NaN becomes null.

    Args:
        path: JSON file.
        content: Nested mappings and sequences of numbers, strings and arrays.
    """
    write_json(path, _plain(content))


def _plain(x: Any) -> Any:
    """The same in types that JSON knows."""
    if isinstance(x, Mapping):
        return {str(key): _plain(value) for key, value in x.items()}
    if isinstance(x, (np.ndarray, np.generic)):
        return _plain(x.tolist())
    if isinstance(x, (list, tuple)):
        return [_plain(value) for value in x]
    if isinstance(x, float) and not np.isfinite(x):
        return None
    return x


def provenance(**given: Any) -> dict[str, Any]:
    """Versions of this package, of Python and of every core dependency.

    It holds no date, host or path, so the same run gives the same record.

    Args:
        **given: What else the result depends on: seeds, hashes of files, the command.

    Returns:
        JSON-ready; ``given`` comes first.
    """
    names = _core_dependencies()
    return {
        **given,
        "hybrid": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in names},
    }


def _core_dependencies() -> list[str]:
    try:
        lines = requires("hybrid-arm") or []
    except PackageNotFoundError:  # run from the source tree, without an installation
        return ["numpy", "scipy", "scikit-learn", "mujoco"]
    return [re.split(r"[^\w.-]", line)[0] for line in lines if "extra ==" not in line]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
