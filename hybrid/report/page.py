"""Write a self-contained HTML page, which opens offline."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hybrid.files import atomic_path
from hybrid.report.output import figure_bytes
from hybrid.report.table import Table

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

_TEMPLATES = Path(__file__).parent / "pages"


@dataclass(frozen=True)
class Section:
    """A section of a page; every part but the title is optional.

    Attributes:
        title: Heading.
        text: Paragraphs, separated by empty lines; not markup.
        table: A table.
        figure: A figure.
        caption: Caption of the figure, also for screen readers.
        html: Markup, which must load nothing.
        command: Command that reproduces the section.
    """

    title: str
    text: str = ""
    table: Table | None = None
    figure: Figure | None = None
    caption: str = ""
    html: Markup | None = None
    command: str = ""

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
    content = render_page(title, sections, lead=lead, provenance=provenance)
    with atomic_path(Path(path)) as temporary:
        temporary.write_text(content, encoding="utf-8")


def render_page(
    title: str,
    sections: Sequence[Section],
    *,
    lead: str = "",
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """The page that :func:`write_page` writes."""
    return render_template(
        "page.html", title=title, lead=lead, sections=sections, provenance=provenance
    )


def render_template(
    name: str, *, provenance: Mapping[str, Any] | None = None, **content: Any
) -> str:
    """Render a template; strings are escaped."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    lines = {name: _line(x) for name, x in (provenance or {}).items()}
    made = [(name, line) for name, line in lines.items() if line]
    return environment.get_template(name).render(provenance=made, **content)


def _line(x: Any) -> str:
    """A value for the foot of a page, in one line."""
    if isinstance(x, Mapping):
        return ", ".join(f"{name} {value}" for name, value in x.items())
    if isinstance(x, Sequence) and not isinstance(x, str):
        values = (y.values() if isinstance(y, Mapping) else [y] for y in x)
        return ", ".join(" ".join(map(str, y)) for y in values)
    return str(x)
