"""A robot file with other joint placements: the new ones, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS, PUBLIC_ARMS, public_arm
from scipy.spatial.transform import Rotation

from hybrid.errors import RobotError
from hybrid.robot import Robot
from hybrid.robot.edit.placements import write_placements

ODD = """<mujoco><compiler angle="degree"/><worldbody>
<body name="a" pos="0 0 .1" euler="10 20 30"><joint name="j1" axis="0 1 .2"
 pos=".1 .2 .3" ref="25"/><geom size=".1"/><!-- kept -->
<body name='b>' pos="0.3 0 .1"><joint name="j2" axis="1 0 0" pos="-.1 .1 0" type="slide"
 ref=".3"/><geom size=".1"/>
<body axisangle="1 1 0 30" pos="0.3 0 .1"><joint name="j3" axis="0 0 1"/>
<geom size=".1"/></body></body></body></worldbody></mujoco>"""


def moved(robot, seed=0):
    rng = np.random.default_rng(seed)
    n = robot.size
    turn = Rotation.from_rotvec(0.1 * rng.normal(size=(n, 3))).as_matrix()
    shift = 0.1 * rng.normal(size=(n, 3))
    chain = robot.chain
    return replace(
        chain, rotation=chain.rotation @ turn, translation=chain.translation + shift
    )


def check(robot, path):
    chain = moved(robot)
    write_placements(robot, chain, path)
    read = Robot.load(path, joints=robot.joints).chain
    np.testing.assert_allclose(read.rotation, chain.rotation, atol=1e-12)
    np.testing.assert_allclose(read.translation, chain.translation, atol=1e-12)
    np.testing.assert_allclose(read.axis, chain.axis, atol=1e-12)
    np.testing.assert_allclose(read.inertial, chain.inertial, atol=1e-10)


@pytest.mark.filterwarnings("ignore::hybrid.errors.HybridWarning")  # frozen fingers
@pytest.mark.parametrize("name", PUBLIC_ARMS)
def test_a_public_urdf_takes_new_placements(name, tmp_path):
    check(public_arm(name), tmp_path / "arm.urdf")


@pytest.mark.parametrize("name", ["coman_like.xml", "scara.urdf", "planar.xml"])
def test_an_own_model_takes_new_placements(name, tmp_path):
    check(Robot.load(MODELS / name), tmp_path / name)


def test_mjcf_with_offsets_references_and_slides_takes_new_placements(tmp_path):
    (tmp_path / "odd.xml").write_text(ODD)
    check(Robot.load(tmp_path / "odd.xml"), tmp_path / "new.xml")
    assert "<!-- kept -->" in (tmp_path / "new.xml").read_text()


@pytest.mark.parametrize("name", ["coman_like.xml", "coman_like.urdf"])
def test_an_unmoved_arm_gives_the_same_bytes(name, tmp_path):
    robot = Robot.load(MODELS / name)
    write_placements(robot, robot.chain, tmp_path / name)
    assert (tmp_path / name).read_bytes() == (MODELS / name).read_bytes()


def test_a_pitch_of_a_right_angle_is_written(tmp_path):
    robot = Robot.load(MODELS / "planar.urdf")
    turn = Rotation.from_euler("xyz", [0.3, np.pi / 2, 0.0]).as_matrix()
    rotation = np.array([turn, turn])
    write_placements(
        robot, replace(robot.chain, rotation=rotation), tmp_path / "arm.urdf"
    )
    read = Robot.load(tmp_path / "arm.urdf").chain.rotation
    np.testing.assert_allclose(read, rotation, atol=1e-9)


def test_two_joints_of_one_body_cannot_be_moved_apart(tmp_path):
    (tmp_path / "two.xml").write_text(
        '<mujoco><worldbody><body><joint name="a" axis="0 0 1"/>'
        '<joint name="b" axis="0 1 0"/><geom size=".1"/></body></worldbody></mujoco>'
    )
    robot = Robot.load(tmp_path / "two.xml")
    with pytest.raises(RobotError, match="one to a body"):
        write_placements(robot, moved(robot), tmp_path / "new.xml")
    assert not (tmp_path / "new.xml").exists()


def test_a_file_that_is_gone_is_named(tmp_path):
    robot = replace(
        Robot.load(MODELS / "planar.urdf"), path=str(tmp_path / "gone.urdf")
    )
    with pytest.raises(RobotError, match="gone.urdf: cannot be read"):
        write_placements(robot, moved(robot), tmp_path / "new.urdf")
