"""Write pages, figures and JSON atomically; record versions and inputs.

A page is self-contained HTML, which opens offline.
"""

import platform
import re
import warnings
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from io import BytesIO
from pathlib import Path
from typing import Any

from hybrid import __version__
from hybrid.errors import HybridError
from hybrid.files import atomic_path, write_json
from hybrid.report.style import Figure
from hybrid.report.table import Table
from hybrid.shown import plain
from hybrid.templates import render_template

_PAGES = Path(__file__).parent / "pages"
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

    There is no date, host or path, so that the same run gives the same record. What is
    ``given``, as seeds, hashes of files or the command, comes first.
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


@dataclass(frozen=True)
class Section:
    """A section of a page; every part but the title is optional."""

    title: str
    text: str = ""  # paragraphs, separated by empty lines; not markup
    table: Table | None = None
    figure: Figure | None = None
    caption: str = ""  # caption of the figure, also for screen readers
    command: str = ""  # command that reproduces the section

    @property
    def paragraphs(self) -> list[str]:
        """Paragraphs of the text."""
        return [part.strip() for part in self.text.split("\n\n") if part.strip()]

    @property
    def image(self) -> str:
        """The figure as an SVG data URI; empty without a figure."""
        if self.figure is None:
            return ""
        # Not inline SVG, where ids of two figures may be equal.
        content = b64encode(figure_bytes(self.figure)).decode("ascii")
        return f"data:image/svg+xml;base64,{content}"


def write_page(
    path: str | Path,
    title: str,
    sections: Sequence[Section],
    *,
    lead: str = "",
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write a page atomically.

    Args:
        path: HTML file.
        title: Heading, and title of the window.
        sections: Sections, in order.
        lead: Result in a sentence or two, under the heading.
        provenance: Versions and inputs, for the foot of the page; see
            :func:`hybrid.report.provenance`.
    """
    content = render_page(
        "page.html", title=title, lead=lead, sections=sections, provenance=provenance
    )
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(content, encoding="utf-8")


def render_page(
    name: str, *, provenance: Mapping[str, Any] | None, **content: Any
) -> str:
    """Render a page; strings are escaped."""
    lines = {name: _line(x) for name, x in (provenance or {}).items()}
    made = [(name, line) for name, line in lines.items() if line]
    return render_template(_PAGES / name, markup=True, provenance=made, **content)


def _line(x: Any) -> str:
    """A value for the foot of a page, in one line."""
    if isinstance(x, Mapping):
        return ", ".join(f"{name} {value}" for name, value in x.items())
    if isinstance(x, Sequence) and not isinstance(x, str):
        values = (y.values() if isinstance(y, Mapping) else [y] for y in x)
        return ", ".join(" ".join(map(str, y)) for y in values)
    return str(x)
