"""Capsules around the shapes of a robot file: what they hold, and how tightly."""

import numpy as np
import pytest
from simulated import quiet

from hybrid.errors import RobotError
from hybrid.excitation.clearance import closest_points
from hybrid.robot import Robot
from hybrid.robot.geometry import capsules_from_robot

URDF = """<robot name="one"><link name="base">{0}</link><link name="arm">{1}<inertial>
  <mass value="2"/><inertia ixx=".01" ixy="0" ixz="0" iyy=".02" iyz="0" izz=".02"/>
  </inertial></link><joint name="turns" type="revolute"><parent link="base"/>
  <child link="arm"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""
MJCF = """<mujoco><worldbody><body><joint name="turns" axis="0 1 0"/>
  <inertial pos="0 0 0" mass="2" diaginertia=".01 .02 .02"/>{0}</body></worldbody>
  </mujoco>"""
AT = np.array([0.1, -0.2, 0.4])


def urdf(tmp_path, shape="", base="", at=AT):
    """Capsules of an arm of one link with a shape, upright at a place."""
    place = '<origin xyz="{} {} {}"/>'.format(*at)
    own, ground = (
        f"<collision>{place}<geometry>{x}</geometry></collision>" if x else ""
        for x in (shape, base)
    )
    (tmp_path / "arm.urdf").write_text(URDF.format(ground, own))
    robot, _ = quiet(Robot.load, tmp_path / "arm.urdf")
    return capsules_from_robot(robot)


def mjcf(tmp_path, shape):
    (tmp_path / "arm.xml").write_text(MJCF.format(shape))
    return capsules_from_robot(Robot.load(tmp_path / "arm.xml"))


CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]])
FACES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


TETRAHEDRON = CORNERS[np.array(FACES)]


def stl(corners=TETRAHEDRON):
    """A binary STL file: 80 bytes, a count, and 50 bytes a triangle."""
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    triangles = np.zeros(len(corners), kind)
    triangles["corners"] = corners
    return bytes(80) + len(corners).to_bytes(4, "little") + triangles.tobytes()


def assert_held(points, capsules):
    """Every point is within one of the capsules."""
    ends = np.stack([points, points], axis=1)[:, None]
    x, y = closest_points(np.repeat(ends, len(capsules.link), 1), capsules.ends[None])
    inside = np.linalg.norm(x - y, axis=2) - capsules.radius
    assert inside.min(axis=1).max() < 1e-6


def obj():
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    return ("\n".join(lines) + "\n").encode()


SHAPES = {
    "sphere": (
        '<sphere radius="0.05"/>',
        '<geom type="sphere" size="0.05" pos=".1 -.2 .4"/>',
    ),
    "capsule": (
        '<capsule radius="0.05" length="0.6"/>',
        '<geom type="capsule" size="0.05 0.3" pos=".1 -.2 .4"/>',
    ),
    "cylinder": (
        '<cylinder radius="0.05" length="0.6"/>',
        '<geom type="cylinder" size="0.05 0.3" pos=".1 -.2 .4"/>',
    ),
    "box": (
        '<box size="0.06 0.08 0.6"/>',
        '<geom type="box" size="0.03 0.04 0.3" pos=".1 -.2 .4"/>',
    ),
}


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
@pytest.mark.parametrize("name", SHAPES)
def test_a_long_shape_gets_a_capsule_of_its_length_that_is_hardly_wider(
    name, kind, tmp_path
):
    """Of a box it goes through the edges, of a cylinder round a polygon about it."""
    of_urdf, of_mjcf = SHAPES[name]
    found = urdf(tmp_path, of_urdf) if kind == "urdf" else mjcf(tmp_path, of_mjcf)
    assert found.link.tolist() == [0]
    half = 0.0 if name == "sphere" else 0.3
    ends = found.ends[0][np.argsort(found.ends[0][:, 2])]
    tight = name in ("sphere", "capsule")
    np.testing.assert_allclose(
        ends, AT + np.outer([-half, half], [0, 0, 1]), atol=1e-12 if tight else 2e-3
    )
    (radius,) = found.radius
    if tight:
        assert radius == pytest.approx(0.05)
    else:
        assert 0.05 <= radius <= 0.052


@pytest.mark.parametrize("thin", [0, 1, 2])
def test_the_smallest_of_the_capsules_along_its_axes_is_taken(thin, tmp_path):
    """A plate is held by one along its long side."""
    size = np.array([0.1, 0.1, 0.1])
    size[thin], size[thin - 1] = 0.02, 0.5
    found = urdf(tmp_path, '<box size="{} {} {}"/>'.format(*size))
    along = np.abs(found.ends[0][1] - found.ends[0][0])
    assert int(np.argmax(along)) == (thin - 1) % 3
    assert along.max() == pytest.approx(0.5, abs=0.01)
    assert found.radius[0] == pytest.approx(np.hypot(0.05, 0.01), rel=0.01)


def test_what_is_on_the_base_is_its_own_and_alone_is_no_arm(tmp_path):
    assert urdf(tmp_path, '<sphere radius="0.1"/>', " ").link.tolist() == [0]
    found = urdf(tmp_path, '<sphere radius="0.1"/>', '<box size="1 1 1"/>')
    assert sorted(found.link.tolist()) == [-1, 0]
    assert [x for x, k in zip(found.names, found.link, strict=True) if k == 0] == [
        "arm_0"
    ]
    with pytest.raises(RobotError, match="no collision geometry of the arm"):
        urdf(tmp_path, "", '<box size="1 1 1"/>')
    with pytest.raises(RobotError, match="no collision geometry"):
        mjcf(tmp_path, "")


@pytest.mark.parametrize(
    ("shape", "at"),
    [
        ('<sphere radius="1001"/>', AT),
        ('<box size="2100 1 1"/>', AT),
        ('<sphere radius="0.1"/>', np.array([0.0, 1200.0, 0.0])),
        ('<sphere radius="nan"/>', AT),
    ],
)
def test_what_reaches_a_kilometre_is_refused(shape, at, tmp_path):
    with pytest.raises(RobotError, match="reaches 1000 m or more|nan|valid"):
        urdf(tmp_path, shape, at=at)
    urdf(tmp_path, '<sphere radius="900"/>')


def test_a_floor_of_a_file_is_no_part_of_the_arm(tmp_path):
    text = MJCF.format('<geom type="sphere" size="0.05"/>')
    text = text.replace("<worldbody>", '<worldbody><geom type="plane" size="9 9 1"/>')
    (tmp_path / "arm.xml").write_text(text)
    found = capsules_from_robot(Robot.load(tmp_path / "arm.xml"))
    assert found.link.tolist() == [0]


SEEN = '<geom name="seen" size=".4" contype="0" conaffinity="0"/>'


def test_what_is_only_seen_does_not_collide(tmp_path):
    hard = '<geom name="hard" size=".1"/>'
    assert mjcf(tmp_path, SEEN + hard).names == ("hard",)
    assert mjcf(tmp_path, SEEN + hard.replace("/>", ' contype="0"/>')).names == (
        "hard",
    )


def test_an_arm_without_collision_geometry_keeps_what_is_seen(tmp_path):
    assert mjcf(tmp_path, SEEN).names == ("seen",)


def test_a_geom_that_collides_in_a_pair_alone_is_kept(tmp_path):
    paired = SEEN.replace("seen", "paired")
    ball = '<body><freejoint/><geom name="ball" size=".1"/></body>'
    text = MJCF.format(SEEN + paired).replace("</worldbody>", f"{ball}</worldbody>")
    pair = '<contact><pair geom1="paired" geom2="ball"/></contact></mujoco>'
    (tmp_path / "arm.xml").write_text(text.replace("</mujoco>", pair))
    robot, _ = quiet(Robot.load, tmp_path / "arm.xml")
    assert capsules_from_robot(robot).names[0] == "paired"


def test_a_mesh_is_found_in_a_folder_above_its_file_or_named(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "m.stl").write_bytes(stl())
    for name in ("meshes/m.stl", "package://meshes/m.stl", "file:///meshes/m.stl"):
        assert (urdf(tmp_path, f'<mesh filename="{name}"/>').link == 0).all()
    for name in ("", "meshes", "m.stl"):
        with pytest.raises(RobotError, match="mesh '.*' is not there"):
            urdf(tmp_path, f'<mesh filename="{name}"/>')


def test_pieces_of_a_bent_mesh_lie_closer_to_it_than_one_would(tmp_path):
    """Two rods at a right angle, each of six triangles about its edges."""
    rods = []
    for a, b in (((0, 0, 0), (0.4, 0, 0)), ((0, 0, 0), (0, 0, 0.4))):
        a, b = np.array(a, float), np.array(b, float)
        for side in np.array([[0, 0.02, 0], [0, -0.02, 0], [0.01, 0, 0.01]]):
            rods += [[a, b, b + side], [a, b + side, a + side]]
    (tmp_path / "m.stl").write_bytes(stl(np.array(rods)))
    found = urdf(tmp_path, '<mesh filename="m.stl"/>', at=np.zeros(3))
    assert len(found.link) == 2
    assert found.radius.max() < 0.06
    assert_held(np.array(rods).reshape(-1, 3), found)


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_a_mesh_is_the_same_body_in_either_format(scale, tmp_path):
    found = []
    for name, content in (("m.stl", stl()), ("m.obj", obj())):
        (tmp_path / name).write_bytes(content)
        mesh = f'<mesh filename="{name}" scale="{scale} {scale} {scale}"/>'
        found.append(urdf(tmp_path, mesh))
    one, two = found
    assert (one.link == 0).all() and (two.link == 0).all()
    np.testing.assert_allclose(one.ends, two.ends, atol=1e-6)
    np.testing.assert_allclose(one.radius, two.radius, atol=1e-6)
    # They hold every corner, and are no larger than balls around all of them.
    assert_held(scale * CORNERS + AT, one)
    assert one.radius.max() < 0.2 * scale


@pytest.mark.parametrize("content", [b"", b"v 0 0\nf 1 2 3\n"])
def test_a_mesh_that_cannot_be_read_is_named(content, tmp_path):
    (tmp_path / "m.obj").write_bytes(content)
    with pytest.raises(RobotError, match=r"m\.obj: not a readable mesh"):
        urdf(tmp_path, '<mesh filename="m.obj"/>')


def test_a_mesh_of_one_small_triangle_is_held(tmp_path):
    corners = 0.01 * np.array([[[0, 0, 0], [1.0, 0, 0], [0.3, 1.5, 0.2]]])
    (tmp_path / "m.stl").write_bytes(stl(corners))
    assert_held(corners[0] + AT, urdf(tmp_path, '<mesh filename="m.stl"/>'))
