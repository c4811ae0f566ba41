"""An arm as lines: what is drawn moves as the arm does."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS, random_arm

from hybrid.report.excitation import Postures
from hybrid.robot import Robot


def test_a_turn_of_the_first_joint_turns_all_about_its_axis():
    robot = Robot.load(MODELS / "planar.xml")
    postures = Postures.of(robot, np.array([[0.3, 0.8], [0.3 + np.pi / 2, 0.8]]))
    axis = robot.chain.rotation[0] @ robot.chain.axis[0]
    origin = robot.chain.translation[0]
    bodies = postures.ends.reshape(2, -1, 3)
    moving = ~np.isclose(bodies[0], bodies[1]).all(axis=1)
    assert moving.any()
    for before, after in zip(*(x - origin for x in bodies[:, moving]), strict=True):
        across = before - axis * (axis @ before)
        turned = axis * (axis @ before) + np.cross(axis, across)
        np.testing.assert_allclose(after, turned, atol=1e-9)


def test_joints_keep_their_distance():
    robot = random_arm(3)
    q = np.random.default_rng(0).uniform(-1, 1, size=(5, robot.size))
    q[:, ~robot.chain.revolute] = 0.0
    lengths = np.linalg.norm(np.diff(Postures.of(robot, q).joints, axis=1), axis=2)
    np.testing.assert_allclose(lengths, lengths[:1].repeat(5, axis=0), atol=1e-9)


@pytest.mark.parametrize("renamed", [False, True])
def test_an_arm_whose_file_is_gone_or_another_by_now_is_its_joints(tmp_path, renamed):
    robot, path = Robot.load(MODELS / "planar.xml"), tmp_path / "arm.xml"
    if renamed:
        text = (MODELS / "planar.xml").read_text("utf-8")
        path.write_text(text.replace("elbow", "another"), "utf-8")
    postures = Postures.of(replace(robot, path=str(path)), np.zeros((1, 2)))
    assert postures.ends.shape == (1, 0, 2, 3) and postures.radius.shape == (0,)
    assert postures.joints.shape == (1, 3, 3)


def test_the_box_holds_every_posture():
    robot = Robot.load(MODELS / "planar.xml")
    postures = Postures.of(robot, np.array([[0.0, 0.0], [2.0, 1.0]]))
    middle, half = postures.box
    for points in (postures.joints, postures.ends):
        assert (np.abs(points - middle) <= half).all()
