"""The verb ``excite``: its files, its pictures and its refusals."""

import csv
import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arms import MODELS
from PIL import Image

from hybrid.cli import main
from hybrid.excitation import Fourier, Limits
from hybrid.excitation.experiments import static_poses
from hybrid.excitation.path import Trajectory
from hybrid.report.excitation import postures_figure
from hybrid.robot import Robot

PLANAR, SCARA = MODELS / "planar.xml", MODELS / "scara.xml"
QUICK = "--order 3 --duration 4 --starts 1"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Output of one run with two motions."""
    out = tmp_path_factory.mktemp("excite")
    command = f"excite --robot {PLANAR} {QUICK} --trajectories 2 --rate 100 "
    command += f"--fill 0.7 --out {out} --json {out}/all.json"
    assert main(command.split()) == 0  # a warning would be an error
    return out


@cache
def limits() -> Limits:
    return Limits.of(Robot.load(PLANAR), fill=0.7)


def table(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open() as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, dtype=float)


@pytest.mark.parametrize("k", [1, 2])
def test_references_keep_the_limits_and_begin_and_end_at_rest(folder, k):
    header, x = table(folder / f"reference_{k}.csv")
    assert header[0] == "t" and len(header) == 7 and len(x) == 401
    q, v, a = x[:, 1:3], x[:, 3:5], x[:, 5:7]
    assert (q >= limits().low).all() and (q <= limits().high).all()
    assert (np.abs(v) <= limits().speed).all()
    assert np.abs(v[[0, -1]]).max() < 1e-9 and np.abs(a[[0, -1]]).max() < 1e-9
    np.testing.assert_allclose(np.gradient(q, 0.01, axis=0)[2:-2], v[2:-2], atol=2e-3)


def test_coefficients_and_figures_of_merit_are_saved(folder):
    content = json.loads((folder / "design.json").read_text("utf-8"))
    described = content["trajectories"][0]
    options = described["family"]
    assert options.pop("name") == "fourier"
    motion = Trajectory(Fourier(**options), np.array(described["coefficients"]))
    _, x = table(folder / "reference_1.csv")
    np.testing.assert_allclose(motion.path(x[:, 0]).q, x[:, 1:3], atol=1e-9)
    assert len(content["standard_errors"]) == len(content["unknowns"])
    assert content["additions"][0] == 1.0 and 0 < content["additions"][1] < 1
    assert max(content["excess"].values()) <= 0
    assert content["provenance"]["hybrid"]
    assert content["criterion"] == "ExpectedError" and content["value"] > 0
    values = content["singular_values"]
    assert values[0] / values[-1] == pytest.approx(content["condition"])
    recorded = json.loads((folder / "all.json").read_text("utf-8"))
    assert recorded["condition"] == content["condition"]


def test_the_condition_number_is_of_the_rigid_body_alone_in_named_columns(
    tmp_path, capsys
):
    """A motion of an earlier run is warned of: it may break the limits of this run."""
    (tmp_path / "reference_2.csv").write_text("t,q1\n")
    command = f"excite --robot {PLANAR} {QUICK} --criterion condition --out {tmp_path}"
    assert main(command.split()) == 0
    content = json.loads((tmp_path / "design.json").read_text("utf-8"))
    assert not any("friction" in x or "coulomb" in x for x in content["unknowns"])
    named = content["rigid_conditions"]
    assert named["first independent columns"] == pytest.approx(content["condition"])
    said, warned = capsys.readouterr()
    assert "also holds reference_2.csv, not of this run" in warned
    assert " % away, where 80% of the file's limits are used (--fill)" in said
    assert all(f"{x:.4g} ({columns})" in said for columns, x in named.items())


def test_pictures_are_drawn(folder):
    for name in ("motion.png", "information.png", "postures.png"):
        with Image.open(folder / name) as picture:
            assert picture.width > 800
        assert (folder / name).stat().st_size < 200_000


def test_an_arm_without_geometry_is_drawn_as_lines():
    robot = replace(Robot.load(PLANAR), path="")
    poses = np.array([[0.0, 0.0], [0.5, -0.5]])
    reference = static_poses(robot, poses, hold=0.2, rate=100.0)
    figure = postures_figure(robot, reference, count=3)
    assert len(figure.axes) == 3
    assert all(len(axes.lines) == 2 for axes in figure.axes)


@pytest.mark.parametrize(
    "more, says",
    [
        ("--floor 9", "no posture keeps the lowest z"),
        ("--floor nan", "--floor is a height"),
        ("--fill 1.5", "fill is 1.5"),
        ("--order 1", "order is 1"),
        ("--effects elasticity", "no law of one joint's state"),
        ("--criterion best", "condition"),
        (f"--robot {SCARA} --duration 0.03", "tell 10 of 11 parameters; valid are lon"),
    ],
)
def test_a_request_that_cannot_be_met_is_refused_in_one_line(
    tmp_path, capsys, more, says
):
    out = tmp_path / "out"
    command = f"excite --robot {PLANAR} {QUICK} --out {out} {more}"
    try:
        code = main(command.split())
    except SystemExit as stopped:
        code = stopped.code
    text = capsys.readouterr().err
    assert code == 2 and says in text
    assert not out.exists()
