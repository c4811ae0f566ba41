"""A file of another arm, or with another gravity, and files that are only a bit off."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import public_arm
from coarse import simulate
from simulated import arm, quiet

from hybrid.diagnosis.diagnose import examine
from hybrid.diagnosis.gap.likeness import unlike
from hybrid.diagnosis.gap.measure import measure_gap
from hybrid.effects.gravity_tilt import GravityTilt
from hybrid.effects.payload import Payload
from hybrid.effects.spring import Spring
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

SHORT = {"trajectories": 2, "duration": 4.0, "log_rate": 250.0}


def rubbing(robot):
    """The arm with rotors and friction of usual size, as public files have none."""
    rated = np.array([x.torque for x in joint_scales(robot)])
    chain = replace(robot.chain, armature=0.02 * rated)
    return replace(robot, chain=chain, damping=0.05 * rated, frictionloss=0.03 * rated)


@cache
def logs(name, kind=""):
    robot = rubbing(public_arm(name) if name == "ur5" else arm(name))
    every = tuple(range(robot.size))
    rated = joint_scales(robot)[1].torque
    effects = {
        "": [],
        "payload": [Payload.typical(every, joint_scales(robot))],
        "spring": [Spring((1,), {"stiffness": 1.5 * rated})],
        "tilt": [GravityTilt(every, {"roll": 0.15, "pitch": -0.1})],
    }[kind]
    return robot, quiet(simulate, robot, effects, **SHORT)[0]


def said(robot, recordings):
    return unlike(measure_gap(robot, recordings)).short


def in_gravity(robot, *gravity):
    return replace(robot, chain=replace(robot.chain, gravity=np.array(gravity, float)))


ARMS = "planar", "ur5", "coman_like"


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize(
    "gravity", [(0, 0, 0), (0, 0, 9.81), (9.81, 0, 0), (4.9, 0, -8.5)]
)
def test_another_gravity_than_that_of_the_file_is_told(name, gravity):
    robot, recordings = logs(name)
    text = said(in_gravity(robot, *gravity), recordings)
    written = ", ".join(f"{x:.1f}" for x in gravity)
    assert text.startswith(f"gravity of the file, ({written}), is not that of the logs")
    assert "-9.8) m/s²" in text


@pytest.mark.parametrize(
    ("kind", "name"),
    [*(("", name) for name in ARMS), ("payload", "scara"), ("spring", "planar")]
    + [("tilt", "coman_like"), pytest.param("spring", "ur5", marks=pytest.mark.study)],
)
def test_one_fault_does_not_make_another_arm(name, kind):
    assert said(*logs(name, kind)) == ""


@pytest.mark.parametrize("name", ARMS)
def test_masses_that_are_off_do_not_make_another_arm(name):
    robot, recordings = logs(name)
    size = np.random.default_rng(1).uniform(0.7, 1.3, (robot.size, 1))
    off = robot.with_inertial(size * robot.chain.inertial)
    assert said(replace(off, damping=0 * off.damping), recordings) == ""


def test_where_gravity_does_not_act_none_is_told_but_that_of_a_file_that_acts():
    robot, recordings = logs("scara")
    assert said(in_gravity(robot, 0, 0, 0), recordings) == ""
    assert "(9.8, 0.0, 0.0), is not" in said(in_gravity(robot, 9.81, 0, 0), recordings)


def named(robot: Robot, other: Robot) -> Robot:
    """Another arm with the names of the joints of one."""
    chain = replace(other.chain, joints=robot.joints)
    return replace(rubbing(other), chain=chain, path=robot.path)


def test_the_file_of_another_arm_is_told():
    robot, recordings = logs("ur5")
    text = said(named(robot, arm("coman_like")), recordings)
    assert text.startswith("links of the file do not fit the logs at ")


@pytest.mark.study
def test_a_headline_begins_with_what_is_wrong_with_the_file():
    robot, recordings = logs("planar")
    weightless = in_gravity(robot, 0, 0, 0)
    found = examine(weightless, recordings).diagnosis
    assert found.sentence.startswith("Not the file of this arm: gravity of the file")
    assert found.verdict in ("partly_explained", "unexplained")
    assert "is the arm mounted otherwise" in found.doubts[0]
