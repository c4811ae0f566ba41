"""Find the tags of a robot file, which need not be valid XML.

The parsers of MuJoCo and URDF accept what is not valid; so does this one.
"""

import html
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hybrid.errors import RobotError
from hybrid.names import printable

_TAG = re.compile(r"""<\s*(/?)\s*([^\s<>/"'=]+)((?:[^<>"']|"[^"]*"|'[^']*')*+)>""")
_SKIPPED = re.compile(r"<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>|<![^>]*>", re.DOTALL)
_ATTRIBUTE = re.compile(r"""([\w:.-]+)\s*=\s*("[^"]*"|'[^']*')""")


class Markup(NamedTuple):
    """A tag: its span in the text, kind, name and attributes."""

    start: int
    end: int
    closes: bool
    empty: bool  # an element without content, which has no end tag
    name: str
    attributes: dict[str, str]


def read_markup(content: bytes) -> str:
    """Text of a file; bytes that are not UTF-8 come back when it is encoded again."""
    return content.decode("utf-8", "surrogateescape")


def markup(text: str, where: str | Path) -> Iterator[Markup]:
    """Tags in order, without comments.

    Raises:
        RobotError: A tag is not closed.
    """
    at = 0
    while (at := text.find("<", at)) >= 0:
        match = _SKIPPED.match(text, at) or _TAG.match(text, at)
        if match is None:
            raise RobotError(
                f"{where}: not a readable robot file (a tag is not closed, "
                f"{printable(text[at : at + 20])!r})"
            )
        if match.re is _TAG:
            closing, name, rest = match.groups()
            given = {k: html.unescape(x[1:-1]) for k, x in _ATTRIBUTE.findall(rest)}
            empty = rest.endswith("/")
            yield Markup(at, match.end(), bool(closing), empty, name, given)
        at = match.end()
