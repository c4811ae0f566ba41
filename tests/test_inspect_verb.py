"""What the verb `inspect` says of a log: its clock, its joints, what it cannot tell."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import MODELS
from wrong_logs import WRONG, healthy

from hybrid.cli import main
from hybrid.inspect import inspect_recording
from hybrid.recording import Recording, write
from hybrid.robot import Robot

SCARA = str(MODELS / "scara.xml")


@cache
def arm() -> Robot:
    return Robot.load(SCARA)


@cache
def log() -> Recording:
    return healthy(arm(), nominal=arm(), seed=3, duration=5.0)


def test_a_right_log_has_no_doubts_and_tells_its_motion():
    found = inspect_recording(log(), arm())
    assert found.doubts == ()
    assert not found.misleads
    speed = np.abs(np.gradient(log().q, log().t, axis=0)).max(axis=0)
    for j, joint in enumerate(found.joints):
        assert (joint.low, joint.high) == (log().q[:, j].min(), log().q[:, j].max())
        assert joint.fastest == pytest.approx(speed[j], rel=0.1)
        assert joint.torque == (log().tau[:, j].min(), log().tau[:, j].max())


def test_a_log_with_a_joint_at_rest_is_saved(tmp_path):
    q = log().q.copy()
    q[:, 0] = 0.5
    found = inspect_recording(replace(log(), q=q, v=None), arm())
    assert found.joints[0].resolution == np.inf and np.isnan(found.doubts[0].evidence)
    found.save(tmp_path / "log.json")
    content = json.loads((tmp_path / "log.json").read_text(encoding="utf-8"))
    assert content["joints"][0]["resolution"] is None
    assert content["doubts"][0]["evidence"] is None


def test_positions_follow_their_command_late():
    late, t = 0.08, log().t
    command = np.stack([np.interp(t + late, t, x) for x in log().q.T], axis=1)
    found = inspect_recording(replace(log(), command=command), arm())
    for joint in found.joints:
        assert joint.lag == pytest.approx(late, abs=1.01 / log().rate)


def test_positions_before_their_command_are_doubted():
    early, t = 0.08, log().t
    command = np.stack([np.interp(t - early, t, x) for x in log().q.T], axis=1)
    found = inspect_recording(replace(log(), command=command), arm())
    for joint in found.joints:
        assert joint.lag == pytest.approx(-early, abs=1.01 / log().rate)
    (doubt,) = (x for x in found.doubts if x.channel == "command")
    assert "q precedes the command, by up to 80 ms" in doubt.line


def test_the_step_of_an_encoder_is_found():
    step = 2 * np.pi / 4096
    coarse = np.round(log().q / step) * step
    found = inspect_recording(replace(log(), q=coarse, v=None, tau=np.zeros(0)))
    assert [j.resolution for j in found.joints] == pytest.approx([step] * arm().size)
    assert all(j.torque is None for j in found.joints)


def test_holes_and_missing_samples_are_counted_apart():
    keep = np.ones(len(log().t), dtype=bool)
    keep[100:160] = False  # a hole
    keep[[300, 400, 401]] = False  # three samples lost
    channels = {name: x[keep] for name, x in log().channels.items()}
    with pytest.warns(match="gaps|irregular"):
        found = inspect_recording(replace(log(), t=log().t[keep], **channels))
    assert found.clock.holes == 1
    assert found.clock.missing == pytest.approx(3 / keep.sum())


def test_what_a_motion_does_not_excite_is_untold():
    moving = inspect_recording(log(), arm()).excitation
    q, tau = log().q.copy(), log().tau.copy()
    q[:, -1] = q[0, -1]
    rests = inspect_recording(replace(log(), q=q, v=None, tau=tau), arm())
    last = arm().joints[-1]
    for name in (f"viscous.coefficient[{last}]", f"coulomb.level[{last}]"):
        assert name in rests.excitation.untold
        assert name in moving.names
    assert moving.condition < 1000 < rests.excitation.condition
    assert rests.joints[-1].moving == 0.0


def test_the_verb_tells_all_and_ends_with_0(tmp_path, capsys):
    path, page, numbers = (tmp_path / x for x in ("a.csv", "a.html", "a.json"))
    write(log(), path)
    asked = ["inspect", str(path), "--robot", SCARA, "--page", str(page)]
    assert main([*asked, "--json", str(numbers)]) == 0
    said = capsys.readouterr().out
    assert "nothing speaks against them" in said
    assert all(joint in said for joint in arm().joints)
    content = json.loads(numbers.read_text())["logs"][0]
    assert content["misleads"] is False
    assert len(content["joints"]) == arm().size
    html = page.read_text()
    assert "a.csv" in html and "data:image/svg" in html
    assert str(tmp_path) not in html


def test_a_log_that_would_mislead_ends_with_2_and_is_told_in_full(tmp_path, capsys):
    path, numbers = tmp_path / "a.csv", tmp_path / "a.json"
    n = arm().size
    write(WRONG["glitches"].make(log(), n - 2, n - 1), path)
    asked = ["inspect", str(path), "--robot", SCARA, "--json", str(numbers)]
    assert main(asked) == 2
    out, err = capsys.readouterr()
    assert "glitch" in err and len(err.splitlines()) == 1
    assert "1 would mislead" in out
    assert json.loads(numbers.read_text())["logs"][0]["misleads"] is True


def test_a_log_without_torque_or_robot_is_taken(tmp_path, capsys):
    path = tmp_path / "a.parquet"
    write(replace(log(), tau=np.zeros(0)), path)
    assert main(["inspect", str(path)]) == 0
    assert "Without torque" in capsys.readouterr().out
