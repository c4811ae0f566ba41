"""Every notebook runs from its first cell to its last."""

import ast
import json
import os
from importlib import import_module
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs" / "notebooks"
DATA = Path(os.environ.get("HYBRID_DATA", FOLDER.parents[2] / "shared" / "data"))
QUICK = ("ur10",)
NAMES = [
    pytest.param(path.stem, marks=() if path.stem in QUICK else pytest.mark.study)
    for path in sorted(FOLDER.glob("*.ipynb"))
]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_to_its_end(name, tmp_path, monkeypatch):
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    if name == "so101" and not (DATA / "so101").is_dir():
        pytest.skip("no logs of so101: set HYBRID_DATA to the folder that has them")
    monkeypatch.setenv("HYBRID_DATA", str(DATA))
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    )
    cells = [x for x in client.execute().cells if x.cell_type == "code"]
    assert all(cell.execution_count for cell in cells) and cells


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda x: x.stem)
def test_what_a_notebook_imports_is_there(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = ["".join(x["source"]) for x in cells if x["cell_type"] == "code"]
    nodes = [node for text in code for node in ast.walk(ast.parse(text))]
    wanted = [
        (node.module, alias.name)
        for node in nodes
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("hybrid")
        for alias in node.names
    ]
    assert wanted
    for module, name in wanted:
        assert hasattr(import_module(module), name), f"{module}.{name}"
