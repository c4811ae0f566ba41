"""``hybrid track``: parameters and payloads along a recording, from the terminal."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS

from hybrid.cli import main
from hybrid.dynamics import inverse_dynamics
from hybrid.effects import effects_from_text
from hybrid.identification import DynamicModel
from hybrid.online import OnlineIdentifier
from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.recording import Recording, read, write
from hybrid.robot import Robot


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model of the planar arm, and a log in which it grasps 1.5 kg at 15 s."""
    path = tmp_path_factory.mktemp("track")
    robot = Robot.load(MODELS / "planar.xml")
    effects = effects_from_text("coulomb,viscous", robot.joints, joint_scales(robot))
    OnlineIdentifier(robot, effects, rate=200.0).model.save(path / "model.json")
    rng = np.random.default_rng(0)
    ref = random_fourier(robot, duration=20.0, rate=200.0, seed=rng)
    loaded = robot.chain.inertial.copy()
    loaded[-1] += 1.5 * np.array([1, 0.05, 0, 0, 0, 0, 0.01, 0, 0, 0.01])
    before, after = (
        inverse_dynamics(robot.chain, x, ref.q, ref.v, ref.a)
        for x in (robot.chain.inertial, loaded)
    )
    tau = np.where(ref.t[:, None] < 15, before, after)
    for effect in effects:
        (j,), x = effect.joints, effect.values
        tau[:, j] += x.get("level", 0.0) * np.sign(ref.v[:, j])
        tau[:, j] += x.get("coefficient", 0.0) * ref.v[:, j]
    tau += 0.05 * rng.standard_normal(tau.shape)
    write(Recording(ref.t, ref.q, tau, joints=robot.joints), path / "log.csv")
    return path


def command(folder, *more):
    paths = {"model": "model.json", "recording": "log.csv", "out": "track.csv"}
    given = [x for k, name in paths.items() for x in (f"--{k}", str(folder / name))]
    return main(["track", *given, *more])


def test_it_writes_every_parameter_over_time_and_says_what_was_grasped(folder, capsys):
    assert command(folder, "--json", str(folder / "track.json")) == 0
    out = capsys.readouterr().out
    assert "kg grasped" in out and "15." in out
    header = (folder / "track.csv").read_text().splitlines()[0]
    rows = np.loadtxt(folder / "track.csv", delimiter=",", skiprows=1)
    content = json.loads((folder / "track.json").read_text())
    names = [p["name"] for p in content["parameters"]]
    assert header.replace('"', "").split(",") == [
        "time", *names, "error_shoulder", "error_elbow",
    ]  # fmt: skip
    assert rows.shape == (201, 1 + len(names) + 2)
    (change,) = content["changes"]
    assert 15 < change["t"] < 15.4
    assert change["mass"] > 0 and content["provenance"]["command"] == "track"
    assert content["health"]["used"] == content["samples"] == 4001
    assert "4,001 of 4,001 samples used" in out
    assert np.abs(rows[140, -2:]).max() < 0.5


def test_it_says_what_became_of_the_samples(folder, capsys):
    rows = (folder / "log.csv").read_text().splitlines()
    held = rows[1001].split(",")[:1] + rows[1000].split(",")[1:]
    kept = [*rows[:1001], ",".join(held), *rows[1002:2001], *rows[2101:]]
    (folder / "worn.csv").write_text("\n".join(kept))
    paths = [str(folder / x) for x in ("model.json", "worn.csv", "worn_track.csv")]
    given = zip(("--model", "--recording", "--out"), paths, strict=True)
    assert main(["track", *(x for pair in given for x in pair)]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert (
        "3,890 of 3,901 samples used, 1 repeated, 10 jumped, 101 missing, 1 restarts"
        in out
    )


def test_the_model_it_starts_from_is_read_back_as_it_is(folder):
    model = DynamicModel.load(folder / "model.json")
    tracker = OnlineIdentifier.from_model(model, rate=200.0)
    assert tracker.model.effects == model.effects
    np.testing.assert_allclose(tracker.model.base.values, model.base.values, atol=1e-12)


def test_bad_input_is_one_line_and_writes_nothing(folder, capsys):
    (folder / "track.csv").unlink(missing_ok=True)
    assert command(folder, "--prior", "-1") == 2
    assert (
        main(["track", "--model", "no.json", "--recording", "x.csv", "--out", "y.csv"])
        == 2
    )
    error = capsys.readouterr().err.strip().splitlines()
    assert len(error) == 2 and all(x.startswith("error: ") for x in error)
    assert not (folder / "track.csv").exists()


def test_a_log_in_milliradians_is_refused_as_by_any_verb(folder, capsys):
    log = read(folder / "log.csv")
    write(replace(log, q=1000 * log.q), folder / "wrong.csv")
    (folder / "track.csv").unlink(missing_ok=True)
    assert command(folder, "--recording", str(folder / "wrong.csv")) == 2
    assert "looks like milliradians; valid are rad" in capsys.readouterr().err
    assert not (folder / "track.csv").exists()
