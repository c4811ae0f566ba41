"""One self-contained HTML page: it opens anywhere, without a network, and prints."""

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
    """One finding and its evidence; every part but the title may be left out.

    Attributes:
        title: Heading.
        text: Paragraphs, with an empty line between two; not markup.
        table: Numbers.
        figure: A drawing.
        caption: What the figure shows; also read out to those who cannot see it.
        html: Markup made elsewhere, which must load nothing.
        command: What to type to get this section's numbers again.
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
        """The text, cut at empty lines."""
        return [part.strip() for part in self.text.split("\n\n") if part.strip()]

    @property
    def image(self) -> str:
        """The figure as an SVG data URI, or nothing."""
        if self.figure is None:
            return ""
        # An image of its own, not inline SVG: ids of two figures cannot collide.
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
    """Write a page; if this fails, an older page stays.

    Args:
        path: HTML file.
        title: Heading, and title of the window.
        sections: What the page says, in order.
        lead: The result in a sentence or two, under the heading.
        provenance: With what it was made, for the foot of the page; see
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
    """A page from a template; strings are escaped.

    Args:
        name: File name of the template.
        provenance: With what it was made, for the foot of the page.
        content: What the template names.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made = [(name, _line(x)) for name, x in (provenance or {}).items()]
    return environment.get_template(name).render(provenance=made, **content)


def _line(x: Any) -> str:
    """A value for the foot of a page: names and what they stand for, or a list.

    Of what is in a list, such as a file and its hash, the values suffice.
    """
    if isinstance(x, Mapping):
        return ", ".join(f"{name} {value}" for name, value in x.items())
    if isinstance(x, Sequence) and not isinstance(x, str):
        return ", ".join(
            " ".join(map(str, each.values()))
            if isinstance(each, Mapping)
            else str(each)
            for each in x
        )
    return str(x)
