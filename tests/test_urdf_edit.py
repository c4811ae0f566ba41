"""A URDF file with other numbers keeps the drives that it has."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from simulated import quiet

from hybrid.effects.torque_offset import TorqueOffset
from hybrid.errors import RobotError
from hybrid.exports import build_simulator
from hybrid.robot import Robot
from hybrid.robot.edit import source
from hybrid.robot.edit.document import Document

LINK = """<link name="{0}"><inertial><origin xyz=".1 0 0"/><mass value="2"/><inertia
  ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
  <origin xyz=".3 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="9" velocity="2"/></joint>"""
DRIVE = """<transmission name="{0}_drive"><type>SimpleTransmission</type>
  <joint name="{0}"/><actuator name="{0}_motor">{1}</actuator></transmission>"""
GEAR, ROTOR = '<drake:gear_ratio value="10"/>', '<drake:rotor_inertia value="2e-3"/>'


def robot_of(tmp_path, drives):
    text = '<robot name="two" xmlns:drake="http://drake.mit.edu"><link name="base"/>'
    text += LINK.format("upper") + LINK.format("lower")
    text += JOINT.format("first", "base", "upper")
    text += JOINT.format("second", "upper", "lower") + drives + "</robot>"
    (tmp_path / "arm.urdf").write_text(text)
    return quiet(Robot.load, tmp_path / "arm.urdf")[0]


@pytest.mark.parametrize(
    ("inside", "reflected"),
    [
        ("", 0.0),
        (GEAR, 0.0),
        (ROTOR, 2e-3),
        (GEAR + ROTOR, 0.2),
        ("<drake:gear_ratio/>" + ROTOR, 2e-3),
    ],
)
def test_a_rotor_is_written_into_the_drive_that_a_file_has(inside, reflected, tmp_path):
    """On its own side of the gear: there a hundredth of it turns ten times as fast."""
    robot = robot_of(
        tmp_path, DRIVE.format("first", "") + DRIVE.format("second", inside)
    )
    np.testing.assert_allclose(robot.chain.armature, [0.0, reflected])
    new = replace(robot, chain=replace(robot.chain, armature=np.array([0.0, 0.5])))
    build_simulator(new, kind="urdf").write(tmp_path / "new.urdf")
    written = (tmp_path / "new.urdf").read_text()
    assert written.count("<transmission") == 2
    assert written.count("rotor_inertia") == 1
    assert written.count("gear_ratio") == inside.count("gear_ratio")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.chain.armature, [0.0, 0.5])
    for name in ("inertial", "translation", "axis"):
        np.testing.assert_array_equal(
            getattr(again.chain, name), getattr(robot.chain, name)
        )


def test_a_drive_of_several_joints_is_that_of_the_first(tmp_path):
    both = DRIVE.format("first", ROTOR).replace(
        '<joint name="first"/>', '<joint name="first"/><joint name="second"/>'
    )
    robot = robot_of(tmp_path, both)
    np.testing.assert_allclose(robot.chain.armature, [2e-3, 0.0])
    new = replace(robot, chain=replace(robot.chain, armature=np.array([2e-3, 0.5])))
    build_simulator(new, kind="urdf").write(tmp_path / "new.urdf")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.chain.armature, [2e-3, 0.5])


def test_a_joint_without_a_drive_gets_one(tmp_path):
    robot = robot_of(tmp_path, DRIVE.format("second", GEAR))
    new = replace(robot, chain=replace(robot.chain, armature=np.array([0.3, 0.0])))
    build_simulator(new, kind="urdf").write(tmp_path / "new.urdf")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.chain.armature, [0.3, 0.0])


SPRUNG = """<gazebo reference="first"><springStiffness>5</springStiffness>
  <springReference>0.4</springReference><mu1>0.2</mu1></gazebo>"""


def test_a_spring_that_a_file_has_is_not_left_out_as_well(tmp_path):
    robot = robot_of(tmp_path, SPRUNG)
    assert robot.stiffness.tolist() == [5.0, 0.0]
    made = build_simulator(robot, kind="urdf")
    assert made.rest == made.notes == () and made.text == made.original


@pytest.mark.parametrize("stiffness, rest", [((7.5, 3.0), (-0.25, 1.0)), ((0, 0),) * 2])
def test_springs_are_written_as_gazebo_reads_them(stiffness, rest, tmp_path):
    robot = robot_of(tmp_path, SPRUNG)
    new = replace(robot, stiffness=np.array(stiffness), springref=np.array(rest))
    made = build_simulator(new, kind="urdf")
    made.write(tmp_path / "new.urdf")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.stiffness, stiffness)
    np.testing.assert_allclose(again.springref, rest)
    assert made.rest == () and b"<mu1>0.2</mu1>" in made.text


def test_a_constant_torque_is_no_spring_of_a_urdf(tmp_path):
    offset = TorqueOffset((1,), {"level": 2.0})
    made = build_simulator(robot_of(tmp_path, SPRUNG), [offset], kind="urdf")
    assert made.rest == (offset,) and made.robot.stiffness.tolist() == [5.0, 0.0]


def test_what_mujoco_reads_as_another_arm_is_not_converted(monkeypatch):
    def refused(*_):
        raise RobotError("of another kind")

    robot = Robot.load(MODELS / "coman_like.urdf")
    assert source._converted(robot)
    monkeypatch.setattr(source, "read", refused)
    assert source._converted(robot) == ""


def test_only_what_is_edited_differs_in_a_file():
    text = b"<?xml version='1.0'?>\n<a k = '1'>\xff<!-- <b> -- -->"
    text += b'\n  <b x="1"/>\n</a >\n'
    document = Document(text, "here")
    (b,) = document.find("a", "b")
    assert document.edited() == text and b.parent is document.root
    document.set(document.root, {"k": 2})
    document.insert_child(b, "<c/>")
    document.insert_after(b, "<d/>")
    document.append("<e/>")
    edited = text.replace(b"'1'", b'"2"').replace(b"\n</a", b"\n  <d/>\n  <e/>\n</a")
    edited = edited.replace(b'<b x="1"/>', b'<b x="1"><c/></b>')
    assert document.edited() == edited


@pytest.mark.parametrize("text", [b"<a><b></a>", b"<a>", b"</a>", b"", b"<a><b"])
def test_a_file_with_open_elements_is_not_edited(text):
    with pytest.raises(RobotError, match="here: not readable XML|here: not a readable"):
        Document(text, "here")
