"""A URDF file with other numbers: its own drives, and meshes of several formats."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import quiet

from hybrid.errors import RobotError
from hybrid.excitation.clearance import closest_points
from hybrid.exports import build_simulator
from hybrid.robot import Robot
from hybrid.robot.geometry import capsules_from_robot

LINK = """<link name="{0}">{1}<inertial><origin xyz=".1 0 0"/><mass value="2"/><inertia
  ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/></inertial></link>"""
JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
  <origin xyz=".3 0 0"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="9" velocity="2"/></joint>"""
DRIVE = """<transmission name="{0}_drive"><type>SimpleTransmission</type>
  <joint name="{0}"/><actuator name="{0}_motor">{1}</actuator></transmission>"""
GEAR, ROTOR = '<drake:gear_ratio value="10"/>', '<drake:rotor_inertia value="2e-3"/>'


def robot_of(tmp_path, drives="", collision=""):
    text = '<robot name="two" xmlns:drake="http://drake.mit.edu"><link name="base"/>'
    text += LINK.format("upper", collision) + LINK.format("lower", "")
    text += JOINT.format("first", "base", "upper")
    text += JOINT.format("second", "upper", "lower") + drives + "</robot>"
    (tmp_path / "arm.urdf").write_text(text)
    return quiet(Robot.load, tmp_path / "arm.urdf")[0]


@pytest.mark.parametrize(
    ("inside", "reflected"),
    [("", 0.0), (GEAR, 0.0), (ROTOR, 2e-3), (GEAR + ROTOR, 0.2)],
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


def test_a_joint_without_a_drive_gets_one(tmp_path):
    robot = robot_of(tmp_path, DRIVE.format("second", GEAR))
    new = replace(robot, chain=replace(robot.chain, armature=np.array([0.3, 0.0])))
    build_simulator(new, kind="urdf").write(tmp_path / "new.urdf")
    again, _ = quiet(Robot.load, tmp_path / "new.urdf")
    np.testing.assert_allclose(again.chain.armature, [0.3, 0.0])


CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def stl():
    """A tetrahedron as a binary STL file: 80 bytes, a count, and 50 a triangle."""
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    triangles = np.zeros(len(FACES), kind)
    triangles["corners"] = CORNERS[np.array(FACES)]
    return bytes(80) + len(FACES).to_bytes(4, "little") + triangles.tobytes()


def obj():
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    return ("\n".join(lines) + "\n").encode()


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_mesh_is_the_same_body_in_either_format(scale, tmp_path):
    found = []
    for name, content in (("m.stl", stl()), ("m.obj", obj())):
        (tmp_path / name).write_bytes(content)
        mesh = f'<mesh filename="{name}" scale="{scale} {scale} {scale}"/>'
        shape = f'<collision><origin xyz="0 0 .4"/><geometry>{mesh}</geometry>'
        robot = robot_of(tmp_path, collision=shape + "</collision>")
        found.append(capsules_from_robot(robot))
    one, two = found
    assert (one.link == 0).all() and (two.link == 0).all()
    np.testing.assert_allclose(one.ends, two.ends, atol=1e-6)
    np.testing.assert_allclose(one.radius, two.radius, atol=1e-6)
    # They hold every corner, and are no larger than balls around all of them.
    points = scale * CORNERS + [0.0, 0.0, 0.4]
    ends = np.stack([points, points], axis=1)[:, None]
    x, y = closest_points(np.repeat(ends, len(one.link), 1), one.ends[None])
    inside = np.linalg.norm(x - y, axis=2) - one.radius
    assert inside.min(axis=1).max() < 1e-6
    assert one.radius.max() < 0.2 * scale


@pytest.mark.parametrize("content", [b"", b"v 0 0\nf 1 2 3\n"])
def test_a_mesh_that_cannot_be_read_is_named(content, tmp_path):
    (tmp_path / "m.obj").write_bytes(content)
    mesh = '<mesh filename="m.obj"/>'
    shape = f"<collision><geometry>{mesh}</geometry></collision>"
    robot = robot_of(tmp_path, collision=shape)
    with pytest.raises(RobotError, match=r"m\.obj: not a readable mesh"):
        capsules_from_robot(robot)
