"""A model of pinocchio is the arm of the file that it was built from."""

import numpy as np
import pinocchio as pin
import pytest
from simulated import quiet

from hybrid.errors import RobotError
from hybrid.robot import Robot

LINK = """<link name="link_{0}"><inertial><origin xyz=".1 -.02 .03" rpy=".1 .2 .3"/>
  <mass value="{1}"/><inertia ixx=".03" ixy=".001" ixz="-.002" iyy=".02" iyz=".003"
  izz=".025"/></inertial></link>"""
JOINT = """<joint name="joint_{0}" type="{1}"><parent link="{2}"/>
  <child link="link_{0}"/>
  <origin xyz="{3}" rpy=".3 -.2 .1"/><axis xyz="{4}"/>
  <limit lower="-{5}" upper="{5}" effort="{6}" velocity="{7}"/>
  <dynamics damping="{8}" friction="{9}"/>{10}</joint>"""


def arm_of(kinds, axes, more=("",) * 9):
    text = '<robot name="arm"><link name="base"/>'
    for k, (kind, axis) in enumerate(zip(kinds, axes, strict=True), 1):
        text += LINK.format(k, 1.0 + k)
        before = f"link_{k - 1}" if k > 1 else "base"
        numbers = 0.5 * k, 10.0 * k, 1.0 + k, 0.1 * k, 0.2 * k
        text += JOINT.format(
            k, kind, before, f"{0.1 * k} 0 .3", axis, *numbers, more[k - 1]
        )
    return text + "</robot>"


def both(text, tmp_path, **options):
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    read, _ = quiet(Robot.load, path, **options)
    built, _ = quiet(Robot.load, pin.buildModelFromUrdf(str(path)), **options)
    return built, read


FIELDS = ("q_min", "q_max", "v_max", "tau_max", "damping", "frictionloss")


def assert_same(one, two):
    assert one.joints == two.joints
    for name in ("rotation", "translation", "axis", "inertial", "gravity", "armature"):
        np.testing.assert_allclose(
            getattr(one.chain, name), getattr(two.chain, name), atol=1e-9
        )
    np.testing.assert_array_equal(one.chain.revolute, two.chain.revolute)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(one, name), getattr(two, name))


@pytest.mark.parametrize(
    ("kinds", "axes"),
    [
        (("revolute", "revolute", "revolute"), ("1 0 0", "0 1 0", "0 0 1")),
        (("prismatic", "prismatic", "prismatic"), ("1 0 0", "0 1 0", "0 0 1")),
        (("revolute", "prismatic", "revolute"), (".6 .8 0", "0 .6 .8", "0 -1 0")),
        (("prismatic", "continuous", "revolute"), (".6 0 .8", "0 0 1", "-1 0 0")),
        (("continuous", "continuous"), ("0 1 0", ".6 0 .8")),
        (("revolute", "fixed", "prismatic"), ("0 1 0", "1 0 0", "0 0 1")),
    ],
)
def test_joints_of_any_kind_on_any_axis_are_those_of_the_file(kinds, axes, tmp_path):
    assert_same(*both(arm_of(kinds, axes), tmp_path))


def test_joints_that_are_not_asked_for_are_held_where_one_says(tmp_path):
    text = arm_of(("revolute",) * 3, ("0 1 0", "1 0 0", "0 0 1"))
    for held in ({}, {"joint_2": 0.4}):
        one, two = both(text, tmp_path, joints=("joint_1", "joint_3"), held=held)
        assert_same(one, two)
        assert one.held == two.held == held


def test_a_joint_that_follows_another_is_no_drive_of_its_own(tmp_path):
    follows = '<mimic joint="joint_1" multiplier="-2" offset="0.1"/>'
    text = arm_of(("revolute",) * 2, ("0 1 0", "0 1 0"), ("", follows))
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    for source in (path, model):
        with pytest.raises(RobotError, match="'joint_2' follows joint 'joint_1'"):
            Robot.load(source)
        with pytest.raises(RobotError, match=r"no joint joint_2.* valid are joint_1"):
            Robot.load(source, joints=("joint_2",))


def test_a_joint_that_follows_a_held_one_is_where_that_takes_it(tmp_path):
    follows = '<mimic joint="joint_1" multiplier="-2" offset="0.1"/>'
    text = arm_of(("revolute",) * 3, ("0 1 0", "0 0 1", "1 0 0"), ("", follows, ""))
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    model = pin.buildModelFromUrdf(str(path), mimic=True)
    given = {"joints": ("joint_3",), "held": {"joint_1": 0.3}}
    one, two = (quiet(Robot.load, source, **given)[0] for source in (path, model))
    assert_same(one, two)
    assert one.held == pytest.approx({"joint_1": 0.3, "joint_2": -0.5})


def test_gravity_and_rotors_of_a_model_count(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(arm_of(("revolute", "prismatic"), ("0 1 0", "0 0 1")))
    model = pin.buildModelFromUrdf(str(path))
    model.gravity.linear = np.array([1.0, 2.0, -3.0])
    model.armature[:] = [0.3, 0.7]
    robot, _ = quiet(Robot.load, model)
    np.testing.assert_array_equal(robot.chain.gravity, [1.0, 2.0, -3.0])
    np.testing.assert_array_equal(robot.chain.armature, [0.3, 0.7])


def test_a_ball_joint_is_named_by_its_kind():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia.FromSphere(2.0, 0.1), pin.SE3.Identity())
    with pytest.raises(RobotError, match="ball.*spherical"):
        Robot.load(model, joints=("ball",))
