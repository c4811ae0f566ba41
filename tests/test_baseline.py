"""What has changed since an arm was healthy, by its own model."""

import json
from dataclasses import replace

import pytest
from arms import MODELS
from coarse import Plant, simulate

from hybrid.cli import main
from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.baseline import Baseline
from hybrid.effects import effect_class
from hybrid.identification import identify
from hybrid.plant import Noise
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
    return simulate(plant, trajectories=count, duration=4.5, seed=seed)


@pytest.fixture(scope="module")
def model():
    return identify(ROBOT, logs(), stages=("friction",)).model


@pytest.mark.study
def test_what_the_model_could_not_have_had_may_be_no_change(model):
    """Of a real TX40, own logs show the ripple and the delay that new ones show."""

    def doubted(kind, *joints, **values):
        return Baseline(model).doubts([effect_class(kind)(joints, values)])

    for kind in ("coulomb", "viscous", "stribeck", "load_friction"):
        assert doubted(kind, 0) == [], kind
    both = range(ROBOT.size)
    assert doubted("payload", *both, mass=1.0) == []
    assert doubted("gravity_tilt", *both, roll=0.1) == []
    assert doubted("contact", *both) == []
    for kind in ("delay", "elasticity", "torque_ripple", "presliding", "torque_gain"):
        (text,) = doubted(kind, 0)
        assert text.startswith(f"the model has no {kind.replace('_', ' ')}: it may")
    knows = replace(model, effects=(effect_class("spring")((0,)),))
    spring = effect_class("spring")
    assert Baseline(knows).doubts([spring((0,))]) == []
    assert Baseline(knows).doubts([spring((1,)), spring((0,))])


def test_friction_that_grew_is_told_by_as_much_as_it_grew(model):
    grown = 0.6 * HEALTHY[0].values["level"]
    worn = effect_class("coulomb")((0,), {"level": grown})
    diagnosis = examine(model, logs([worn], seed=3)).diagnosis
    (finding,), doubts = diagnosis.findings, diagnosis.doubts
    assert not doubts
    assert "coulomb" in finding.alternatives and finding.joints == (ROBOT.joints[0],)
    (level,) = finding.parameters[:1]
    low, high = level.interval
    assert low <= grown <= high


@pytest.mark.study
@pytest.mark.parametrize("gain", [-0.13, 0.1])
def test_a_drive_that_gives_less_has_its_size_with_the_healthy_friction(model, gain):
    """The log shows a share of all torque, of the friction in the model as well."""
    weak = effect_class("torque_gain")((1,), {"gain": gain})
    (finding,) = examine(model, logs([weak], seed=4)).diagnosis.findings
    assert (finding.effect, finding.joints) == ("torque_gain", ROBOT.joints[1:])
    low, high = finding.parameters[0].interval
    assert low <= gain <= high


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
