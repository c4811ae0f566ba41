"""A diagnosis as a recording: arms stand where they should, viewers can read it."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from diagnosed import faultless, planar
from scipy.spatial.transform import Rotation

from hybrid.cli import main
from hybrid.diagnosis.answer.replay import simulated_positions
from hybrid.excitation.clearance import frames
from hybrid.report.viewers import Scene, scene_of_diagnosis, writer_of

NAMES = ("measured", "as the file stands", "with what was found")


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of_diagnosis(planar())


def test_replays_start_as_measured_and_findings_bring_them_nearer(scene):
    measured, file, found = (scene.q[name] for name in NAMES)
    known = ~np.isnan(found).any(axis=1)
    assert known.mean() > 0.8
    assert (file[known] == measured[known]).all(axis=1).any()
    off, left = (np.abs(x - measured)[known].mean() for x in (file, found))
    assert left < 0.5 * off


def test_a_simulator_without_a_gap_moves_as_measured():
    scene = scene_of_diagnosis(faultless())
    measured, file, found = (scene.q[name] for name in NAMES)
    for x in (file, found):
        assert np.nanmean(np.abs(x - measured)) < 0.01


def test_logs_shorter_than_a_replay_have_none():
    result = planar()
    never = [replace(m, mask=m.mask & (np.arange(len(m.t)) < 20))
             for m in result.gap.motions]  # fmt: skip
    gap = replace(result.gap, motions=tuple(never))
    for course in simulated_positions(replace(result.scored, gap=gap)):
        assert course.shape == gap.left.shape and np.isnan(course).all()


def test_torque_of_the_file_and_the_gap_make_up_what_was_measured(scene):
    torque, gap = scene.curves["torque"], scene.curves["gap"]
    whole = torque[NAMES[1]] + gap[NAMES[1]]
    assert np.allclose(whole, torque[NAMES[0]])
    seen = ~np.isnan(gap[NAMES[2]])
    assert 0 < seen.mean() < 1
    assert np.std(gap[NAMES[2]][seen]) < np.std(gap[NAMES[1]][seen])


def test_links_stand_where_the_kinematics_puts_them(scene):
    turn, place = scene.poses(NAMES[0])
    R, p, _ = frames(scene.robot.chain, scene.q[NAMES[0]])
    assert np.allclose(place, p)
    found = Rotation.from_quat(turn.reshape(-1, 4)).as_matrix()
    assert np.allclose(found, R.reshape(-1, 3, 3))


def test_a_simulator_that_was_not_replayed_stands_where_the_arm_was(scene):
    lost = {
        NAMES[0]: scene.q[NAMES[0]],
        NAMES[1]: np.full_like(scene.q[NAMES[0]], np.nan),
    }
    alone = replace(scene, curves={"position": lost})
    for mine, measured in zip(
        alone.poses(NAMES[1]), scene.poses(NAMES[0]), strict=True
    ):
        assert np.array_equal(mine, measured)


def test_an_arm_without_geometry_is_lines_from_joint_to_joint(scene):
    bare = replace(scene, robot=replace(scene.robot, path="gone.urdf"))
    (base, ends, _, length, turn), (link, *_) = bare.links()
    assert (base, link) == (-1, 0)
    place = scene.robot.chain.translation[0]
    np.testing.assert_allclose(ends, [[np.zeros(3), place]])
    np.testing.assert_allclose(length, [np.linalg.norm(place)])
    along = Rotation.from_quat(turn).apply([0.0, 0.0, 1.0]) * length
    np.testing.assert_allclose(along, [place], atol=1e-12)


def test_rerun_can_read_it(scene, tmp_path):
    pytest.importorskip("rerun")
    path = tmp_path / "gap.rrd"
    writer_of(path)(scene, path)
    rerun = [sys.executable, "-m", "rerun_cli", "rrd"]
    subprocess.run([*rerun, "verify", path], check=True, capture_output=True)
    told = subprocess.run(
        [*rerun, "stats", path], check=True, capture_output=True, text=True
    )
    said = told.stdout.replace("\\", "")
    for joint in scene.robot.joints:
        assert f"/arm/{NAMES[2]}/{joint}" in said
        for kind, name, _ in scene.each():
            assert f"/{kind}/{joint}/{name}" in said


def test_foxglove_can_read_it(scene, tmp_path):
    pytest.importorskip("foxglove")
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "gap.mcap"
    writer_of(path)(scene, path)
    found = {}
    with path.open("rb") as file:
        for schema, channel, message in reader.make_reader(file).iter_messages():
            found.setdefault(channel.topic, []).append((schema, message))
    assert {x.name for x, _ in found["/tf"]} == {"foxglove.FrameTransforms"}
    assert [x.name for x, _ in found["/scene"]] == ["foxglove.SceneUpdate"]
    assert len(found["/tf"]) == len(scene.t)
    for kind, name, x in scene.each():
        rows = [json.loads(m.data) for _, m in found[f"/{kind}/{name}"]]
        read = np.array([[row[j] for j in scene.robot.joints] for row in rows], float)
        assert np.array_equal(read, x, equal_nan=True)
    times = [m.log_time for _, m in found["/tf"]]
    assert np.allclose(times, 1e9 * (scene.t - scene.t[0]), atol=1)


def test_what_cannot_be_written_is_said_before_any_work(tmp_path, capsys, monkeypatch):
    robot = MODELS / "planar.xml"
    verb = f"diagnose --robot {robot} --recordings {robot} --out {tmp_path}/out --rerun"
    assert main(f"{verb} {tmp_path}/gap.txt".split()) == 2
    assert "valid are .rrd and .mcap" in capsys.readouterr().err
    monkeypatch.setattr("hybrid.extras.find_spec", lambda _: None)
    assert main(f"{verb} {tmp_path}/gap.rrd".split()) == 2
    assert "pip install 'hybrid-arm[viewers]'" in capsys.readouterr().err
    assert not any(tmp_path.iterdir())
