"""What has changed since an arm was healthy, by its own model."""

import json

import pytest
from arms import MODELS

from hybrid.cli import main
from hybrid.diagnosis.diagnose import examine
from hybrid.effects import effect_class
from hybrid.identification import identify
from hybrid.plant import Noise, Plant, simulate
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

PLANAR = MODELS / "planar.xml"
ROBOT = Robot.load(PLANAR)
SCALES = joint_scales(ROBOT)
HEALTHY = [
    effect_class(kind).typical((j,), SCALES)
    for kind in ("coulomb", "viscous", "stribeck")
    for j in range(ROBOT.size)
]


def logs(more=(), seed=1, count=4):
    plant = Plant(ROBOT, [*HEALTHY, *more], nominal=ROBOT, noise=Noise.typical(ROBOT))
    return simulate(plant, trajectories=count, duration=6.0, seed=seed)


@pytest.fixture(scope="module")
def model():
    return identify(ROBOT, logs(), stages=("friction",)).model


def test_friction_that_grew_is_told_by_as_much_as_it_grew(model):
    grown = 0.6 * HEALTHY[0].values["level"]
    worn = effect_class("coulomb")((0,), {"level": grown})
    (finding,) = examine(model, logs([worn], seed=3)).diagnosis.findings
    assert "coulomb" in finding.alternatives and finding.joints == (ROBOT.joints[0],)
    (level,) = finding.parameters[:1]
    low, high = level.interval
    assert low <= grown <= high


def test_an_arm_that_has_not_changed_has_no_gap_for_the_command(
    model, tmp_path, capsys
):
    from hybrid.recording import write

    for k, x in enumerate(logs(seed=4)):
        write(x, tmp_path / f"log_{k}.csv")
    model.save(tmp_path / "model.json")
    command = f"diagnose --recordings {tmp_path}/log_0.csv --out {tmp_path}/out"
    assert main(command.split()) == 2
    assert "either --robot or --baseline" in capsys.readouterr().err
    both = f"{command} --baseline {tmp_path}/model.json"
    assert main(f"{both} --robot {PLANAR}".split()) == 2
    assert main(f"{both} --joints a,b".split()) == 2
    assert not (tmp_path / "out").exists()
    assert main(both.split()) == 0
    answer = json.loads((tmp_path / "out/diagnosis.json").read_text())
    assert answer["verdict"] == "no_gap" and not answer["findings"]
