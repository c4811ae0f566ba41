"""Names in files are data: what a name may be, and how each kind of output spells it.

A name of a joint or of an arm is a line of printable text. Nothing in it is an order to
anybody: each writer spells it by the function here that is for its kind of output.
"""

from __future__ import annotations

import re

LONGEST = 128  # characters of a name
_LONGEST_STEM = 48  # characters; of four bytes each they still fit into a file's name
# Names that mean something else: C's headers, CMake's targets, and va_start.
_TAKEN = frozenset(
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp "
    "signal stdarg stdbool stddef stdint stdio stdlib string tgmath time wchar wctype "
    "all all_build clean edit_cache example_double example_single help install package "
    "package_source preinstall rebuild_cache run_tests test va zero_check".split()
)
_DEVICES = re.compile(r"(con|prn|aux|nul|(com|lpt)\d)(\..*)?", re.IGNORECASE)


def name_fault(name: object) -> str:
    """What is wrong with a name, in words; nothing if it is one.

    Args:
        name: What a file gives as the name of a joint or of an arm.
    """
    if (
        isinstance(name, str)
        and name.isprintable()
        and name.strip()
        and len(name) <= LONGEST
    ):
        return ""
    shown = ascii(name)
    if len(shown) > LONGEST:
        shown = f"{shown[:LONGEST]}…"
    return f"name {shown}; valid are 1 to {LONGEST} printable characters"


def printable(text: str) -> str:
    """Text for a terminal or a comment: what would steer it is written as an escape."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def file_stem(name: str) -> str:
    """A file's name without suffix: no separator, no leading dot, never empty."""
    stem = re.sub(r"[^\w.-]", "_", name).lstrip(".-")[:_LONGEST_STEM].rstrip(".")
    return f"{stem or 'arm'}{'_' if _DEVICES.fullmatch(stem) else ''}"


def c_identifier(name: str) -> str:
    """A lower-case C identifier that no header of C and no target of CMake has."""
    found = re.sub(r"\W", "_", name, flags=re.ASCII).strip("_").lower()
    found = found[:_LONGEST_STEM].rstrip("_")
    if not found or found[0].isdigit() or found in _TAKEN:
        found = f"arm_{found}".rstrip("_")
    return found


def c_comment(name: str) -> str:
    """A name within a comment of C: letters and digits of any script, few signs."""
    return "".join(c if c.isalnum() or c in " _-.:,+" else "_" for c in name)


def xml_comment(text: str) -> str:
    """A line within a comment of XML, which two hyphens would end."""
    return re.sub(r"--+|-$", "-", printable(text)).removesuffix("-")


def markdown(text: str) -> str:
    """A cell of a table in Markdown: no column ends in it, and no element begins."""
    return re.sub(r"([\\|]|<(?=[A-Za-z/!?]))", r"\\\1", printable(text))


def figure_text(text: str) -> str:
    """Text of a figure, in which a dollar is a dollar and not a formula."""
    return text.replace("$", r"\$")
