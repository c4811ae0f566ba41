"""The command line that all experiments share, and the report that they write."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path
from typing import Any

from hybrid.files import atomic_path
from hybrid.report import Table, markdown_table, provenance, write_results


def command_line(doc: str | None, name: str) -> ArgumentParser:
    """A parser with ``--out``, the folder that receives the report.

    The reports of the repository are written only when they are named.

    Args:
        doc: Docstring of the experiment; its first line is shown.
        name: Name of its report.
    """
    parser = ArgumentParser(description=(doc or "").split("\n")[0])
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out") / name,
        help="folder for the report (default: %(default)s)",
    )
    return parser


def captioned(*tables: Table) -> str:
    """Tables in Markdown, each below its caption."""
    return "\n".join(f"{x.caption}.\n\n{markdown_table(x)}" for x in tables)


def write_tables(
    folder: Path, text: str, command: str, *, stem: str = "table", **content: Any
) -> None:
    """Write ``table.md``, which ends with its command, and ``results.json``.

    Args:
        folder: Where to write.
        text: Tables in Markdown, and what is said of them.
        command: What makes the report again.
        stem: Name of the first file; the second has "results" in place of "table".
        content: The numbers.
    """
    with atomic_path(folder / f"{stem}.md") as path:
        path.write_text(f"{text}\n    {command}\n", encoding="utf-8")
    results = folder / f"{stem.replace('table', 'results')}.json"
    write_results(results, {"provenance": provenance(command=command), **content})
