"""Write figures and JSON atomically; record versions and inputs."""

from __future__ import annotations

import platform
import re
import warnings
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, requires, version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid import __version__
from hybrid.errors import HybridError
from hybrid.files import atomic_path, write_json
from hybrid.shown import plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESOLUTION = 150  # pixels per inch, of PNG files and of rasters inside SVG files


def figure_bytes(figure: Figure, kind: str = "svg") -> bytes:
    """Content of a figure's file; the same figure gives the same bytes.

    Args:
        figure: Any figure.
        kind: ``svg``, ``png`` or ``pdf``.

    Raises:
        HybridError: The kind is unknown.
    """
    # No date and a fixed salt for ids, so that the file depends on the data only.
    timeless = {"svg": {"Date": None}, "png": {}, "pdf": {"CreationDate": None}}
    if kind not in timeless:
        raise HybridError(
            f"no figure of kind {kind!r}; valid are {', '.join(timeless)}"
        )
    from matplotlib import rc_context

    target = BytesIO()
    with rc_context({"svg.hashsalt": "hybrid"}), warnings.catch_warnings():
        # The font may lack a character of a joint's name, and draw a box instead.
        warnings.filterwarnings("ignore", "Glyph .* missing", UserWarning)
        figure.savefig(target, format=kind, dpi=RESOLUTION, metadata=timeless[kind])
    return _palette(target) if kind == "png" else target.getvalue()


def _palette(image: BytesIO) -> bytes:
    """Reduce a PNG to 128 colours, which makes it a third of the size."""
    from PIL import Image

    target = BytesIO()
    with Image.open(image) as picture:
        few = picture.convert("RGB").quantize(128, dither=Image.Dither.NONE)
    few.save(target, format="png", optimize=True)
    return target.getvalue()


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as ``.svg``, ``.png`` or ``.pdf``, by the suffix of the path.

    Raises:
        HybridError: The suffix is unknown.
    """
    path = Path(path)
    content = figure_bytes(figure, path.suffix.lstrip(".").lower())
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_results(path: str | Path, content: Mapping[str, Any]) -> None:
    """Write results as JSON; arrays become lists, NaN becomes null."""
    write_json(path, plain(content))


def provenance(**given: Any) -> dict[str, Any]:
    """Versions of this package, of Python and of every core dependency.

    There is no date, host or path, so that the same run gives the same record.

    Args:
        **given: Other inputs: seeds, hashes of files, the command.

    Returns:
        JSON-ready content; ``given`` comes first.
    """
    return {
        **given,
        "hybrid": __version__,
        "python": platform.python_version(),
        "packages": {name: _version(name) for name in _core_dependencies()},
    }


def _core_dependencies() -> list[str]:
    try:
        lines = requires("hybrid-arm") or []
    except PackageNotFoundError:  # the source tree without an installation
        return ["numpy", "scipy", "scikit-learn", "mujoco"]
    return [re.split(r"[^\w.-]", line)[0] for line in lines if "extra ==" not in line]


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
