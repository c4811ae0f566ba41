"""``hybrid diagnose``: the verdict, the folder, and nothing half-written."""

import json
import re
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console
from test_cli import PLANAR, complaint, run, tree, without_progress

from hybrid.cli.shared.options import sha256
from hybrid.cli.shared.screen import Screen
from hybrid.effects import registry
from hybrid.errors import EffectError
from hybrid.identification import DynamicModel
from hybrid.recording import Recording, read, write
from hybrid.robot import Robot

OWN = """
import numpy as np
from hybrid.effects import JointEffect, Port, Quantity

class Hose(JointEffect):
    id = "hose"
    port = Port.ENVIRONMENT
    gains = (Quantity("level", "N·m", 0.05, 0.0, 1.0, per=(1, 0)),)
    equation = "τ = k · exp(-(q - 0.3)² / 0.02)"
    source = "made up"
    sentence = "A hose gets stuck at {joints}."
    remedy = "Take it off."

    @staticmethod
    def law(state, **shapes):
        return (np.exp(-(((state.q - 0.3) / 0.14) ** 2)),)
"""


@pytest.fixture(scope="module")
def logs(tmp_path_factory) -> Path:
    """A planar arm whose elbow has Stribeck friction that its simulator has not."""
    folder = tmp_path_factory.mktemp("logs")
    run(
        f"simulate --robot {PLANAR} --effects stribeck:elbow(level=1.5;velocity=0.1) "
        f"--trajectories 4 --duration 4.5 --out {folder}"
    )
    return folder


@pytest.fixture
def diagnose(logs) -> str:
    return f"diagnose --robot {PLANAR} --recordings {logs}"


@pytest.fixture(scope="module")
def answered(logs, tmp_path_factory) -> SimpleNamespace:
    """One run: its folder, what it printed, and what it told while it worked."""
    folder, shown = tmp_path_factory.mktemp("answered"), []
    whole, out, err = Screen.working, StringIO(), StringIO()

    @contextmanager
    def working(self, text):
        shown.append(text)
        with whole(self, text) as tell:
            yield lambda text, *done: (shown.append(text), tell(text, *done))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Screen, "working", working)
        with redirect_stdout(out), redirect_stderr(err):
            run(
                f"diagnose --robot {PLANAR} --recordings {logs} "
                f"--out {folder}/deep/new --json {folder}/result.json"
            )
    return SimpleNamespace(
        folder=folder,
        written=folder / "deep/new",
        out=out.getvalue(),
        err=err.getvalue(),
        shown=shown,
    )


def test_it_names_the_cause_in_ten_lines_and_in_a_folder(answered):
    tmp_path = answered.folder
    steps = answered.err.splitlines()  # where nobody looks, a line for each long one
    assert all(re.fullmatch(r"\d+ s: \w.*", x) for x in steps)
    *verdict, report, simulator, exact = answered.out.splitlines()
    assert len(verdict) <= 10
    assert verdict[0].startswith("Stribeck friction at elbow; ")
    assert verdict[1].startswith("Explained: one effect accounts for")
    assert any(line.startswith("1. Stribeck friction at elbow") for line in verdict)
    assert report == f"Report: {tmp_path}/deep/new/report.html"
    assert simulator.endswith(f": {tmp_path}/deep/new/sim_fixed.xml")
    assert exact.startswith(f"Exact in {tmp_path}/deep/new/model.json only: friction ")
    page = (tmp_path / "deep/new/report.html").read_text("utf-8")
    assert '<a href="sim_fixed.xml">' in page
    found = tree(tmp_path)
    names = ("report.html", "diagnosis.json", "sim_fixed.xml", "model.json")
    assert {*(f"deep/new/{name}" for name in names), "result.json"} <= set(found)
    assert not any(Path(name).name.startswith(".") for name in found)
    content = json.loads(found["result.json"])
    assert content == json.loads(found["deep/new/diagnosis.json"])
    (finding,) = content["findings"]
    assert (finding["effect"], finding["joints"]) == ("stribeck", ["elbow"])
    assert content["sentence"] == verdict[0] and finding["probability"] > 0.95
    assert finding["class"][0]["effect"] == "stribeck"
    assert b"Stribeck" in found["deep/new/report.html"]


def test_the_simulator_it_writes_can_be_loaded(answered):
    fixed = Robot.load(answered.written / "sim_fixed.xml")
    assert fixed.joints == ("shoulder", "elbow")
    model = DynamicModel.load(answered.written / "model.json")
    assert "stribeck" in [effect.id for effect in model.effects]


@pytest.mark.study
def test_a_simulator_that_cannot_be_written_is_a_warning(
    diagnose, tmp_path, capsys, monkeypatch
):
    def refused(*_, **__):
        raise EffectError("hose cannot be simulated")

    monkeypatch.setattr(
        import_module("hybrid.diagnosis.answer.fixed"), "write_fixed", refused
    )
    run(f"{diagnose} --out {tmp_path}/out")
    out, err = capsys.readouterr()
    assert out.splitlines()[-1].startswith("Report: ")
    warning = "warning: no corrected simulator: hose cannot be simulated\n"
    assert without_progress(err) == warning
    assert set(tree(tmp_path / "out")) == {"report.html", "diagnosis.json"}


@pytest.mark.study
def test_much_that_the_simulator_has_not_is_said_in_few_words(
    diagnose, tmp_path, capsys, monkeypatch
):
    fixed = import_module("hybrid.diagnosis.answer.fixed")
    notes = tuple(f"torque_ripple of joint_{k}" for k in range(9))
    whole = fixed.write_fixed

    def written(*given, **more):
        whole(*given, **more)
        return notes

    monkeypatch.setattr(fixed, "write_fixed", written)
    run(f"{diagnose} --out {tmp_path}/out")
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.endswith("joint_2; 6 more at the top of that file")
    assert "joint_3" not in last


@pytest.mark.study
def test_it_says_how_the_result_came_about(diagnose, logs, tmp_path):
    run(f"{diagnose} --cutoff 9 --seed 5 --out {tmp_path}/out")
    text = (tmp_path / "out" / "diagnosis.json").read_text("utf-8")
    how = json.loads(text)["provenance"]
    assert (how["command"], how["seed"]) == ("diagnose", 5)
    assert how["settings"] == {
        "joints": None,
        "hold": {},
        "map": None,
        "cutoff": 9,
        "known_mass": {},
        "gpu": False,
    }
    hashes = {x["file"]: x["sha256"] for x in how["inputs"]}
    assert hashes["planar.xml"] == sha256(Path(PLANAR))
    assert hashes["trajectory_4.csv"] == sha256(logs / "trajectory_4.csv")
    assert str(logs) not in text and hashes["trajectory_4.csv"] in (
        tmp_path / "out" / "report.html"
    ).read_text("utf-8")


@pytest.mark.study
def test_the_same_run_gives_the_same_files_and_leaves_others_alone(
    diagnose, answered, tmp_path
):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "report.html").write_text("old")
    run(f"{diagnose} --out {tmp_path}")
    again = tree(tmp_path)
    assert again.pop("notes.txt") == b"mine"
    assert again == tree(answered.written)


@pytest.mark.study
def test_what_cannot_be_told_apart_is_said_with_what_to_run_next(tmp_path, capsys):
    run(
        f"simulate --robot {PLANAR} --effects torque_offset:elbow --trajectories 2 "
        f"--duration 5 --seed 1 --out {tmp_path}/logs"
    )
    capsys.readouterr()
    logs = f"--recordings {tmp_path}/logs"
    run(f"diagnose --robot {PLANAR} {logs} --out {tmp_path}/out")
    lines = capsys.readouterr().out.splitlines()
    (cause,) = (line for line in lines if line.startswith("1. "))
    assert "Torque offset" in cause or "Asymmetric friction" in cause
    assert "torque offset" in cause.lower() and "asymmetric friction" in cause.lower()
    (advice,) = (line for line in lines if line.startswith("Next: "))
    content = json.loads((tmp_path / "out" / "diagnosis.json").read_text("utf-8"))
    first = content["advice"][0]
    assert first["experiment"] in advice
    assert {"torque_offset", "asymmetric_friction"} <= set(first["splits"])
    assert not first["file"] or (tmp_path / "out" / first["file"]).is_file()


@pytest.mark.study
def test_effects_of_a_users_own_take_part(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(registry, "_added", {})
    (tmp_path / "mine.py").write_text(OWN, "utf-8")
    own = f"--effects-from {tmp_path}/mine.py"
    run(
        f"simulate --robot {PLANAR} --effects hose:elbow(level=3) --trajectories 4 "
        f"--duration 4 --out {tmp_path}/logs {own}"
    )
    diagnose = f"diagnose --robot {PLANAR} --recordings {tmp_path}/logs"
    run(f"{diagnose} --out {tmp_path}/out {own}")
    assert "1. Hose at elbow" in capsys.readouterr().out
    assert "A hose gets stuck at elbow." in (tmp_path / "out/report.html").read_text(
        "utf-8"
    )


def test_progress_is_told_step_by_step(answered):
    assert answered.shown[:2] == ["reading recordings", "diagnosing planar"]
    assert answered.shown[-1] == "writing the report"
    assert len(answered.shown) > 4


def test_a_file_has_a_line_for_each_step_that_takes_its_time(monkeypatch):
    clock = iter([0.0, 0.5, 10.0, 10.2, 20.0, 30.0])
    monkeypatch.setattr("hybrid.cli.shared.screen.monotonic", lambda: next(clock))
    screen, target = Screen(), StringIO()
    screen._err = Console(file=target, width=80)
    with screen.working("at first") as tell:
        tell("too short")
        tell("a quarter", 0.25)
        tell("too short again", 0.3)
        tell("half", 0.5)
        tell("who knows")
    assert target.getvalue().splitlines() == [
        "10 s: a quarter (about 30 s left)",
        "20 s: half (about 20 s left)",
        "30 s: who knows",
    ]


def test_a_terminal_shows_what_is_being_done():
    screen, target = Screen(), StringIO()
    screen._err = Console(file=target, force_terminal=True, width=80)
    with screen.working("at first") as tell:
        tell("and now this")
    assert "and now this" in target.getvalue()


@pytest.mark.study
@pytest.mark.parametrize("is_new", [True, False])
@pytest.mark.parametrize(
    ("home", "step"),
    [
        ("hybrid.diagnosis.diagnose", "examine"),
        ("hybrid.report.diagnosis", "write_results"),  # the page is written by then
    ],
)
def test_ctrl_c_leaves_what_was_there(
    diagnose, tmp_path, capsys, monkeypatch, is_new, home, step
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    if not is_new:
        out.mkdir()
        (out / "report.html").write_text("old")
    before = tree(tmp_path)
    monkeypatch.setattr(import_module(home), step, interrupted)
    assert "interrupted" in complaint(capsys, f"{diagnose} --out {out}", code=130)
    assert tree(tmp_path) == before
    assert out.exists() is not is_new


def test_bad_input_is_one_line_and_writes_nothing(diagnose, logs, tmp_path, capsys):
    log = read(logs / "trajectory_1.csv")
    write(Recording(t=log.t, q=log.q, joints=log.joints), tmp_path / "silent.csv")
    still = {"q": 0 * log.q + 0.3, "tau": log.tau}
    write(Recording(t=log.t, **still, joints=log.joints), tmp_path / "still.csv")
    (tmp_path / "file").write_text("in the way")
    before = tree(tmp_path)
    alone = f"diagnose --robot {PLANAR} --recordings {tmp_path}"
    for command, words in {
        f"diagnose --recordings {logs}": "--out",
        f"diagnose --recordings {logs} --out {tmp_path}/x": "either --robot or",
        f"diagnose --robot {PLANAR} --recordings nowhere --out {tmp_path}/x": "nowhere",
        f"diagnose --robot no.xml --recordings {logs} --out {tmp_path}/x": "no.xml",
        f"{diagnose} --out {tmp_path}/file": "file",
        f"{diagnose} --out {tmp_path}/x --cutoff 0": "above 0",
        f"{diagnose} --out {tmp_path}/x --json {tmp_path}": "is a folder",
        f"{diagnose} --joints elbow,knee --out {tmp_path}/x": "knee",
        f"{alone}/silent.csv --out {tmp_path}/x": "neither torque nor command",
        f"{alone}/still.csv --out {tmp_path}/x": "no joint moves",
    }.items():
        assert words in complaint(capsys, command), command
    assert tree(tmp_path) == before


@pytest.mark.study
def test_it_is_the_public_function(answered, logs):
    import hybrid

    robot = hybrid.Robot.load(PLANAR)
    found = hybrid.diagnose(robot, hybrid.read_recordings(logs, joints=robot.joints))
    assert isinstance(found, hybrid.Diagnosis)
    written = answered.folder / "result.json"
    expected = json.loads(written.read_text("utf-8"))
    content = json.loads(json.dumps(found.as_dict()))
    assert content | {"provenance": {}} == expected | {"provenance": {}}
