"""A weighed mass settles the scale of torque, which no drive gain is trusted with."""

import json
from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from coarse import Plant, simulate

import hybrid
from hybrid.cli import main
from hybrid.diagnosis.answer.words import verdict_lines
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.scale import settled
from hybrid.effects import effect_class
from hybrid.errors import IdentificationError, RobotError
from hybrid.identification import identify
from hybrid.plant import Noise
from hybrid.recording import write
from hybrid.robot import Robot

PLANAR = MODELS / "planar.xml"
ROBOT = Robot.load(PLANAR)
SCALE = 0.9
LOAD = {"mass": 3.0, "mx": 0.15, "mz": 0.3, "Ixx": 0.06, "Iyy": 0.09, "Izz": 0.045}
PAYLOAD = effect_class("payload")((0, 1), LOAD)


def logs(more=(), seed=1, scale=SCALE):
    """Logs of drives whose gains are all off by one factor."""
    plant = Plant(ROBOT, list(more), nominal=ROBOT, noise=Noise.typical(ROBOT))
    found = simulate(plant, trajectories=4, duration=4.5, seed=seed)
    return [replace(x, tau=scale * x.tau) for x in found]


def healthy(scale=SCALE):
    """A model of the arm without its payload."""
    return identify(ROBOT, logs(scale=scale), stages=("rigid",)).model


def values(diagnosis):
    (finding,) = diagnosis.findings
    assert finding.effect == "payload"
    return {x.name: x for x in finding.parameters}


@pytest.fixture(scope="module")
def model():
    return healthy()


@pytest.fixture(scope="module")
def result(model):
    return examine(model, logs([PAYLOAD], seed=3))


def test_a_mass_from_torque_is_as_doubtful_as_the_gains_of_the_drives(result):
    """Its interval holds the truth, which that of the logs alone does not."""
    found, (effect,) = values(result.diagnosis), result.effects
    mass = found["mass"]
    assert mass.value == pytest.approx(SCALE * LOAD["mass"], rel=0.02)
    assert mass.value + 1.96 * effect.std["mass"] < LOAD["mass"]
    for name in ("mass", "mx", "Izz"):
        low, high = found[name].interval
        assert low < LOAD[name] < high, name
    spread = effect_class("torque_gain").gains[0].deviation
    half = 1.96 * np.hypot(effect.std["mass"], spread * mass.value)
    assert mass.interval == pytest.approx((mass.value - half, mass.value + half))
    (finding,), scale = result.diagnosis.findings, result.diagnosis.torque_scale
    assert scale is None
    assert "scale of the logged torque" in finding.note
    assert "--known-mass" in finding.note and "17%" in finding.note


@pytest.mark.study
def test_a_known_payload_tells_the_scale_for_the_command(model, tmp_path, capsys):
    model.save(tmp_path / "model.json")
    for k, x in enumerate(logs([PAYLOAD], seed=3)):
        write(x, tmp_path / f"log_{k}.csv")
    out = tmp_path / "out"
    command = f"diagnose --baseline {tmp_path}/model.json --recordings {tmp_path}/*.csv"
    command = f"{command} --out {out} --known-mass"
    for wrong, said in (("wrist=3", "valid are shoulder, elbow"), ("elbow=0", "0 kg")):
        assert main([*command.split(), wrong]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert said in line and not out.exists()
    assert main([*command.split(), "elbow=3"]) == 0
    answer = json.loads((out / "diagnosis.json").read_text())
    scale, (finding,) = answer["torque_scale"], answer["findings"]
    low, high = scale["interval"]
    assert low < SCALE < high < 1.0
    assert scale["value"] == pytest.approx(SCALE, rel=0.02)
    found = {x["name"]: x for x in finding["parameters"]}
    assert found["mass"]["value"] == 3.0 and found["mass"]["interval"] == [3.0, 3.0]
    for name in ("mx", "Izz"):
        low, high = found[name]["interval"]
        assert low < LOAD[name] < high, name
        assert found[name]["value"] == pytest.approx(LOAD[name], rel=0.03), name
    assert "true SI units" in finding["note"]
    said = "Logged torque is 0.90 of the true torque (95% interval"
    page = (out / "report.html").read_text("utf-8")
    shown = capsys.readouterr().out
    for text in (shown, page):
        assert said.replace("0.90", f"{scale['value']:.3f}") in text


@pytest.mark.study
def test_a_right_scale_is_one():
    loaded = logs([PAYLOAD], seed=3, scale=1.0)
    found = examine(healthy(1.0), loaded, known_mass={"elbow": 3.0}).diagnosis
    assert found.torque_scale is not None
    low, high = found.torque_scale.interval
    assert low < 1.0 < high and high - low < 0.2
    assert found.torque_scale.value == pytest.approx(1.0, rel=0.02)
    assert values(found)["mx"].value == pytest.approx(LOAD["mx"], rel=0.02)


def test_a_mass_that_the_logs_do_not_show_sets_no_scale(result):
    diagnosis, effects = result.diagnosis, result.effects
    with pytest.raises(
        IdentificationError, match="mounted at shoulder; valid is elbow"
    ):
        settled(diagnosis, effects, {"shoulder": 3.0})
    with pytest.raises(IdentificationError, match="they show none at all"):
        settled(diagnosis, [], {"elbow": 3.0})
    (effect,) = effects
    vague = effect.at({}, {**effect.std, "mass": effect.values["mass"]})
    with pytest.raises(IdentificationError, match="too uncertain for a scale"):
        settled(diagnosis, [vague], {"elbow": 3.0})


def test_a_scale_beside_another_gap_may_be_that_of_no_drive(result):
    """Gains that differ leave a gap, or look like other effects."""
    diagnosis, known = result.diagnosis, {"elbow": 3.0}
    assert diagnosis.verdict == "explained"
    assert settled(diagnosis, result.effects, known).doubts == diagnosis.doubts
    (payload,) = diagnosis.findings
    more = replace(payload, effect="torque_gain")
    for other in (
        replace(diagnosis, verdict="partly_explained"),
        replace(diagnosis, findings=(payload, more)),
    ):
        other = replace(other, doubts=("one", "two", "three"))
        found = settled(other, result.effects, known)
        assert "gains may differ from drive to drive" in found.doubts[0]
        # What must not be used is not said to be known.
        assert found.torque_scale is not None and not found.torque_scale.determined
        said = "\n".join(verdict_lines(found))
        assert "not determined" in said and "gains may differ" in said


@pytest.mark.parametrize("mass", [0.0, -1.0, np.nan, np.inf])
def test_no_mass_is_refused_before_any_work(model, mass):
    for simulator in (model, ROBOT):
        with pytest.raises(RobotError, match="masses above 0"):
            hybrid.diagnose(simulator, [], known_mass={"elbow": mass})


def test_a_weighed_link_tells_wrong_drives_from_a_wrong_file():
    """Torque shows masses by their ratios: the file's are all off by one factor."""
    heavy = ROBOT.with_inertial(1.25 * ROBOT.chain.inertial)
    known = {"elbow": float(ROBOT.chain.inertial[1, 0])}
    found = examine(heavy, logs(seed=3), known_mass=known).diagnosis
    (finding,) = found.findings
    assert (finding.effect, finding.joints) == ("torque_gain", ROBOT.joints)
    for gain in finding.parameters:
        low, high = gain.interval
        assert low < SCALE - 1.0 < high < 0.0
    assert any("0.8 times the masses of the file" in x for x in found.warnings)
