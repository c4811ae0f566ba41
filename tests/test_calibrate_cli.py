"""``hybrid calibrate``: from poses to measure to a calibrated robot file."""

import json

import numpy as np
import pytest
from arms import MODELS
from test_calibrate import disturbed, flange

from hybrid.calibration import read_measurements
from hybrid.cli import main
from hybrid.robot import Robot

ARM = str(MODELS / "coman_like.urdf")


def write_poses(path, q, seed=0):
    """A tracker's log of a disturbed arm in millimetres; its fourth pose is wrong."""
    rng = np.random.default_rng(seed)
    R, p = flange(disturbed(Robot.load(ARM).chain), q)
    seen = 1e3 * (p + R @ [0.05, 0.02, 0.1] + 5e-5 * rng.normal(size=p.shape))
    seen[3] += 30.0
    header = ",".join([f"q{k + 1}" for k in range(6)] + [f"{c} [mm]" for c in "xyz"])
    np.savetxt(path, np.hstack([q, seen]), "%.9f", ",", header=header, comments="")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrate")
    plan = f"calibrate --robot {ARM} --choose 40 --out {folder}/plan"
    assert main(plan.split()) == 0
    q = np.loadtxt(folder / "plan" / "poses.csv", delimiter=",", skiprows=1)
    write_poses(folder / "poses.csv", q)
    command = f"calibrate --robot {ARM} --poses {folder}/poses.csv --out {folder}/new"
    assert main([*command.split(), "--json", f"{folder}/results.json"]) == 0
    return folder


def test_chosen_poses_keep_to_the_limits(folder):
    robot = Robot.load(ARM)
    q = np.loadtxt(folder / "plan" / "poses.csv", delimiter=",", skiprows=1)
    assert q.shape == (40, 6)
    assert (q >= robot.q_min - 1e-6).all() and (q <= robot.q_max + 1e-6).all()


def test_chosen_poses_read_back_whatever_the_joints_are_called(tmp_path):
    text = (MODELS / "planar.urdf").read_text("utf-8")
    arm = tmp_path / "arm.urdf"
    arm.write_text(text.replace('"shoulder"', '"a, b"'), encoding="utf-8")
    run = f"calibrate --robot {arm} --choose 6 --measure pose --out {tmp_path}/plan"
    assert main(run.split()) == 0
    plan = tmp_path / "plan" / "poses.csv"
    names, *rows = plan.read_text("utf-8").splitlines()
    more = ["x,y,z", *["0.1,0.2,0.3"] * len(rows)]
    lines = [",".join(x) for x in zip([names, *rows], more, strict=True)]
    plan.write_text("\n".join(lines), encoding="utf-8")
    joints = Robot.load(arm).joints
    assert "a, b" in joints
    assert read_measurements(plan, joints).q.shape == (6, 2)


def test_the_new_file_is_nearer_to_the_true_arm(folder):
    q = np.random.default_rng(5).uniform(-1, 1, (30, 6))
    true = disturbed(Robot.load(ARM).chain)

    def shape_error(chain):
        """Distances between points of the flange: free of base and tool."""
        a, b = (flange(c, q)[1] for c in (chain, true))
        apart = np.linalg.norm(a[:15] - a[15:], axis=1)
        return np.abs(apart - np.linalg.norm(b[:15] - b[15:], axis=1)).max()

    new = Robot.load(folder / "new" / "coman_like.urdf").chain
    assert shape_error(new) < 0.3 * shape_error(Robot.load(ARM).chain)


def test_the_summary_tells_errors_intervals_and_outliers(folder):
    summary = json.loads((folder / "new" / "calibration.json").read_text())
    assert summary["measured"] == "position"
    assert summary["errors"]["position"]["calibrated"]["median"] < 2e-4
    assert summary["errors"]["position"]["nominal"]["median"] > 1e-3
    assert [x["pose"] for x in summary["rejected"]] == [4]
    for x in summary["parameters"]:
        low, high = x["interval"]
        assert low < x["value"] < high
    assert any("theta_base: joins base_rz" in x for x in summary["unidentifiable"])
    assert summary["provenance"]["inputs"][1]["file"] == "poses.csv"
    results = json.loads((folder / "results.json").read_text())
    assert results["parameters"] == summary["parameters"]


def test_wrong_columns_are_an_error_and_leave_nothing(folder, tmp_path, capsys):
    (tmp_path / "bad.csv").write_text("q1,q2,x,y,z\n0,0,1,2,3\n")
    command = f"calibrate --robot {ARM} --poses {tmp_path}/bad.csv --out {tmp_path}/new"
    assert main(command.split()) == 2
    assert "no position of joint 'elbow'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("was", "read", "code"),
    [
        ("[mm]", "[m]", 2),
        ("q1,q2", "q2,q1", 2),
        ("q1,q2,q3,q4,q5,q6", "q1,q2,q3,q4,q6,q5", 130),  # the hand alone is wrong
    ],
)
def test_wrong_columns_are_refused_or_suspected_before_the_long_fit(
    folder, tmp_path, capsys, monkeypatch, was, read, code
):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("hybrid.cli.calibrate.calibrate", interrupted)
    names, rows = (folder / "poses.csv").read_text().split("\n", 1)
    assert was in names
    (tmp_path / "poses.csv").write_text(f"{names.replace(was, read)}\n{rows}")
    command = f"calibrate --robot {ARM} --poses {tmp_path}/poses.csv"
    assert main([*command.split(), "--out", f"{tmp_path}/new"]) == code
    assert "check units and order" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_reflector_that_no_pose_saw_does_not_hide_wrong_units(
    folder, tmp_path, capsys
):
    names, *rows = (folder / "poses.csv").read_text().splitlines()
    names = names.replace("[mm]", "[m]") + ",x_2 [m],y_2 [m],z_2 [m]"
    lines = [names, *(f"{row},,," for row in rows)]
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    command = f"calibrate --robot {ARM} --poses {tmp_path}/poses.csv"
    assert main([*command.split(), "--out", f"{tmp_path}/new"]) == 2
    assert "check units and order" in capsys.readouterr().err
