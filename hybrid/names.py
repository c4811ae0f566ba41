"""Check the names of joints and arms, and write them safely into each kind of output.

A name comes from a file and may hold any printable text, also markup or code. Each
writer calls the function here for its kind of output.
"""

import re
from collections.abc import Iterable

LONGEST = 128  # characters of a name
_LONGEST_STEM = 48  # characters; with four bytes each they still fit into a file name
# Names in use: headers of C, targets of CMake, and va_start.
_TAKEN = frozenset(
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp "
    "signal stdarg stdbool stddef stdint stdio stdlib string tgmath time wchar wctype "
    "all all_build clean edit_cache example_double example_single help install package "
    "package_source preinstall rebuild_cache run_tests test va zero_check".split()
)
_DEVICES = re.compile(r"(con|prn|aux|nul|(com|lpt)\d)(\..*)?", re.IGNORECASE)


def name_fault(name: object) -> str:
    """Say what is wrong with the name of a joint or an arm; empty if it is valid."""
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
    """Text for a terminal or a comment: control characters become escapes."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def file_stem(name: str) -> str:
    """File name without suffix: no separator, no leading dot, never empty."""
    stem = re.sub(r"[^\w.-]", "_", name).lstrip(".-")[:_LONGEST_STEM].rstrip(".")
    return f"{stem or 'arm'}{'_' if _DEVICES.fullmatch(stem) else ''}"


def file_stems(names: Iterable[str]) -> dict[str, str]:
    """File name without suffix for each name, all different on disks of any kind."""
    found: dict[str, str] = {}
    taken: set[str] = set()  # some disks do not tell capitals from small letters
    for name in names:
        stem = first = file_stem(name)
        again = 1
        while stem.casefold() in taken:
            again += 1
            stem = f"{first}_{again}"
        found[name] = stem
        taken.add(stem.casefold())
    return found


def c_identifier(name: str) -> str:
    """Lower-case C identifier that is no header of C and no target of CMake."""
    found = re.sub(r"\W", "_", name, flags=re.ASCII).strip("_").lower()
    found = found[:_LONGEST_STEM].rstrip("_")
    if not found or found[0].isdigit() or found in _TAKEN:
        found = f"arm_{found}".rstrip("_")
    return found


def c_comment(name: str) -> str:
    """Text for a comment in C: letters and digits of any script, few other signs."""
    return "".join(c if c.isalnum() or c in " _-.:,+" else "_" for c in name)


def xml_comment(text: str) -> str:
    """Text for a comment in XML, which must not hold two hyphens in a row."""
    return re.sub(r"--+|-$", "-", printable(text)).removesuffix("-")


def markdown(text: str) -> str:
    """Text for a table cell in Markdown: pipes and the start of tags are escaped."""
    return re.sub(r"([\\|]|<(?=[A-Za-z/!?]))", r"\\\1", printable(text))


def figure_text(text: str) -> str:
    """Text for a figure, where an unescaped dollar would start a formula."""
    return text.replace("$", r"\$")
