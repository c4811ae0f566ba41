"""Experiments write where they are told to, and nowhere else by themselves."""

import ast
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "experiments"
FILES = sorted(FOLDER.glob("*.py"))
MAINS = [file for file in FILES if 'if __name__ == "__main__":' in file.read_text()]


@pytest.mark.parametrize("file", MAINS, ids=lambda file: file.stem)
def test_every_experiment_takes_a_folder_to_write_to(file, monkeypatch, capsys):
    """Its help shows ``--out``; the default lies outside the repository's reports."""
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr("sys.argv", [str(file), "--help"])
    with pytest.raises(SystemExit) as end:
        runpy.run_path(str(file), run_name="__main__")
    said = capsys.readouterr().out
    assert end.value.code == 0
    assert "--out OUT" in said and "(default: out/" in said


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_no_module_of_an_experiment_names_a_report_of_the_repository(file):
    """Docstrings may speak of ``reports/``; what runs may not."""
    tree = ast.parse(file.read_text())
    spoken = {id(x.value) for x in ast.walk(tree) if isinstance(x, ast.Expr)}
    named = [
        x.value
        for x in ast.walk(tree)
        if isinstance(x, ast.Constant) and isinstance(x.value, str)
        if id(x) not in spoken and x.value.startswith("reports")
    ]
    assert not named
