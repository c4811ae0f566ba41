"""The demo: a real log from reading to a model, in any folder and without a network."""

import socket

import pytest

from hybrid.cli import main
from hybrid.errors import HybridError
from hybrid.examples import example_robots
from hybrid.extras import check_extra
from hybrid.identification import DynamicModel
from hybrid.robot import Robot


@pytest.fixture
def offline(monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("the demo reached for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)


def test_the_demo_identifies_a_real_ur10(tmp_path, monkeypatch, capsys, offline):
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    said = capsys.readouterr().out
    assert "1 in doubt" in said
    assert "+ friction" in said
    assert said.splitlines()[-1].endswith("hybrid inspect LOGS --robot ROBOT.urdf")
    model = DynamicModel.load("hybrid-demo/model.json")
    assert model.robot.joints[0] == "shoulder_pan_joint"
    assert (tmp_path / "hybrid-demo" / "torque.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("name", ["coman_like", "planar", "scara", "ur10"])
def test_an_example_robot_loads_by_its_name(name):
    assert Robot.load(name).size == Robot.load(example_robots()[name]).size


def test_a_missing_package_is_named_with_the_extra_that_brings_it():
    with pytest.raises(HybridError, match=r"pip install 'hybrid-arm\[learn\]'"):
        check_extra("no_such_package", "learn", "A network")
