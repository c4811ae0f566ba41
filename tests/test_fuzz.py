"""The fuzzer itself: its seeds are taken, and it notices what it is there to notice."""

import json
import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))
import one  # noqa: E402
import readers  # noqa: E402

from hybrid.errors import HybridError  # noqa: E402


@pytest.mark.parametrize("name", readers.READERS)
def test_seeds_are_taken_and_damaged_ones_end_in_one_line(name, tmp_path, capfd):
    reader = readers.READERS[name]
    seeds = reader.seeds(tmp_path)
    folder = tmp_path / "c" if name == "manifest" else tmp_path
    for seed in seeds:
        (folder / reader.name).write_bytes(seed)
        assert reader.outcome(folder / reader.name) == "taken"
    rng, outcomes = random.Random(0), set()
    for _ in range(30):
        (folder / reader.name).write_bytes(one.mutated(rng.choice(seeds), rng))
        outcomes.add(reader.outcome(folder / reader.name))
    assert "refused" in outcomes
    capfd.readouterr()  # the URDF parser has its own say on the error stream


def raising(error):
    def read(path):
        raise error

    return readers.Reader("x.txt", read, lambda _: [b"x"])


@pytest.mark.parametrize(
    "error", [KeyError("x"), HybridError("two\nlines"), HybridError("")]
)
def test_a_traceback_and_a_refusal_of_two_lines_are_findings(
    tmp_path, monkeypatch, error
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(readers.READERS, "bad", raising(error))
    feed = one.Feeder("bad", 1, tmp_path)
    feed(b"x")
    counts = json.loads((tmp_path / "counts.json").read_text())
    assert counts["inputs"] == 1 and len(counts["findings"]) == 1
    assert (tmp_path / "finding_1").read_bytes() == b"x"


def test_a_file_that_is_left_and_time_that_is_taken_are_findings(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(one, "SLOW", -1.0)
    litter = readers.Reader("x.txt", lambda p: Path("LOG").write_text("x"), list)
    monkeypatch.setitem(readers.READERS, "bad", litter)
    one.Feeder("bad", 1, tmp_path)(b"x")
    counts = json.loads((tmp_path / "counts.json").read_text())
    assert counts["left"] == 1 and "TimeoutError" in str(counts["findings"])
