"""The command line that all experiments share; nothing here prints or writes."""

from __future__ import annotations

from argparse import ArgumentParser
from pathlib import Path


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
