"""What the documentation says to type can be typed, and the Python page is complete."""

import ast
import inspect
import json
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

import hybrid
from hybrid.cli import build_parser, main

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]


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


def programs():
    """Python blocks of all pages, and what each imports from here by name."""
    for page in PAGES:
        blocks = re.findall(r"```python\n(.*?)```", page.read_text("utf-8"), re.S)
        for k, block in enumerate(blocks):
            yield pytest.param(ast.parse(block), id=f"{page.name} {k + 1}")


@pytest.mark.parametrize("program", [*programs()])
def test_every_call_of_the_documentation_fits_what_it_calls(program):
    nodes = [*ast.walk(program)]
    known = {
        alias.asname or alias.name: getattr(import_module(node.module), alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and node.module.startswith("hybrid")
        for alias in node.names
    }
    wrong = []
    for call in (x for x in nodes if isinstance(x, ast.Call)):
        name, *path = ast.unparse(call.func).split(".")
        if name in known and all(x.isidentifier() for x in path):
            called = known[name]
            for x in path:
                called = getattr(called, x)
            given = {x.arg: x.value for x in call.keywords if x.arg}
            try:
                inspect.signature(called).bind(*call.args, **given)
            except TypeError as error:
                wrong.append(f"{ast.unparse(call)}: {error}")
    assert wrong == []


def newcomers_effect():
    text = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    return code


def test_the_newcomers_effect_is_found_again_as_printed(tmp_path, monkeypatch, capsys):
    (tmp_path / "models").symlink_to(ROOT / "models")
    (tmp_path / "mine.py").write_text(newcomers_effect(), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    for line in commands(ROOT / "CONTRIBUTING.md"):
        words = shlex.split(line)[1:]
        more = {"simulate": ["--duration", "6"], "identify": ["--json", "fit.json"]}
        assert main([*words, *more.get(words[0], [])]) == 0
    unknowns = json.loads(Path("fit.json").read_text("utf-8"))["unknowns"]
    found = {x["label"]: x["interval"] for x in unknowns}
    truth = json.loads(Path("logs/truth.json").read_text("utf-8"))
    for x in truth["effects"]:
        low, high = found[f"{x['effect']}.slope[{x['joints'][0]}]"]
        assert 0 < low <= x["values"]["slope"] <= high
    answer = json.loads(Path("diagnosis/diagnosis.json").read_text("utf-8"))
    assert [x["effect"] for x in answer["findings"]] == ["quadratic_viscous"]
    page = Path("diagnosis/report.html").read_text("utf-8")
    assert "Add a quadratic damping term to the joint." in page
    exported = Path("sim/planar.xml").read_text("utf-8")
    damping = [x.split() for x in re.findall(r'damping="([^"]*)"', exported)]
    assert len(damping) == 2 and all(float(x[1]) > 0.01 for x in damping)


def test_the_notebook_of_an_own_effect_has_the_printed_one():
    text = (ROOT / "docs" / "notebooks" / "own_effect.ipynb").read_text("utf-8")
    cells = ["".join(x["source"]) for x in json.loads(text)["cells"]]
    assert any(newcomers_effect() in x for x in cells)


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
