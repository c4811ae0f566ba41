"""What the documentation says to type can be typed, and the Python page is complete."""

import re
import shlex
from pathlib import Path

import pytest

import hybrid
from hybrid.cli.command import build_parser

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def commands(page):
    for block in re.findall(r"```(?:sh|bash)\n(.*?)```", page.read_text("utf-8"), re.S):
        for line in block.replace("\\\n", " ").splitlines():
            if line.startswith("hybrid "):
                yield line


LINES = [(page.name, line) for page in PAGES for line in commands(page)]


@pytest.mark.parametrize(("page", "line"), LINES)
def test_every_command_of_the_documentation_is_understood(page, line):
    words = shlex.split(line, comments=True)[1:]
    _, unknown = build_parser().parse_known_args(words)
    assert not unknown


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text("utf-8").split()) <= 900


def test_the_python_page_names_everything_public():
    shown = (ROOT / "docs" / "api.md").read_text("utf-8")
    missing = []
    for name in hybrid.__all__:
        thing = getattr(hybrid, name)
        if callable(thing):
            where = f"::: {thing.__module__}.{thing.__name__}\n"
            missing += [] if where in shown else [where]
    assert not missing
