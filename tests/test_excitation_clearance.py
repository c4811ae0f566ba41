"""Distances between links: geometry, gradients, and motions that keep them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from arms import MODELS, public_arm
from pendulum import pendulum

from hybrid.dynamics import inverse_dynamics
from hybrid.dynamics.kinematics import frames
from hybrid.errors import ExcitationError, HybridWarning, RobotError
from hybrid.excitation import (
    Clearance,
    Condition,
    Floor,
    Fourier,
    Limits,
    design,
    observe,
)
from hybrid.excitation.clearance import (
    closest_points,
    ends_in_world,
    point_change,
)
from hybrid.excitation.constraints import TorqueLimits
from hybrid.excitation.path import Path, uniform
from hybrid.robot import Robot
from hybrid.robot.geometry import Capsules, capsules_from_robot

COMAN = Robot.load(MODELS / "coman_like.xml")


def still(q):
    return path_of(q, np.zeros_like(q), np.zeros_like(q))


def path_of(q, v, a):
    return Path(np.arange(float(len(q))), q, v, a, np.zeros_like(q))


def test_closest_points_are_no_farther_than_any_others():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 300, 2, 3))
    second[:20] = first[:20] + 0.1  # parallel
    first[20:30, 1] = first[20:30, 0]  # a point
    x, y = closest_points(first, second)
    s = np.linspace(0, 1, 60)[:, None]
    on_first = first[:, :1] + s * (first[:, 1:] - first[:, :1])
    on_second = second[:, :1] + s * (second[:, 1:] - second[:, :1])
    every = np.linalg.norm(on_first[:, :, None] - on_second[:, None], axis=-1)
    found = np.linalg.norm(x - y, axis=1)
    assert (found <= every.min(axis=(1, 2)) + 1e-9).all()
    assert (found >= every.min(axis=(1, 2)) - 0.05).all()


def test_capsules_of_urdf_and_mjcf_are_alike():
    other = Robot.load(MODELS / "coman_like.urdf")
    first, second = (capsules_from_robot(x) for x in (COMAN, other))
    assert np.array_equal(first.link, second.link)
    np.testing.assert_allclose(first.radius, second.radius, atol=1e-6)


SHAPES = """<mujoco><compiler angle="radian"/><asset>
  <mesh name="wedge" vertex="0 0 0  .2 0 0  0 .1 0  0 0 .3  .2 .1 .3"/></asset>
  <worldbody><body><joint name="turns" axis="0 0 1"/>
    <geom name="rod" type="capsule" fromto="0 0 0 .3 0 .1" size=".02"/>
    <geom name="ball" type="sphere" pos=".1 .1 0" size=".05"/>
    <body pos=".3 0 .1" euler=".4 .2 0"><joint name="slides" type="slide" axis="1 0 0"/>
      <geom name="block" type="box" size=".02 .05 .1" pos="0 .2 0"/>
      <geom name="egg" type="ellipsoid" size=".02 .05 .1" pos="0 -.2 0"/>
      <geom name="part" type="mesh" mesh="wedge" pos="0 0 .2" euler="0 1 0"/>
  </body></body></worldbody></mujoco>"""


@pytest.fixture
def shapes(tmp_path):
    (tmp_path / "shapes.xml").write_text(SHAPES)
    return Robot.load(tmp_path / "shapes.xml")


def surface(model, data, g, rng):
    """Points of a geom in the world, shape (N, 3)."""
    size, kind = model.geom_size[g], model.geom_type[g]
    way = rng.normal(size=(200, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    kinds = mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        x = model.mesh_vert
    elif kind == kinds.mjGEOM_BOX:
        x = size * np.sign(way)
    elif kind == kinds.mjGEOM_ELLIPSOID:
        x = size * way
    else:  # a ball at either end, or alone
        half = size[1] * (kind == kinds.mjGEOM_CAPSULE)
        x = size[0] * way + np.outer(np.sign(way[:, 2]), [0.0, 0.0, half])
    return x @ data.geom_xmat[g].reshape(3, 3).T + data.geom_xpos[g]


@pytest.mark.parametrize("q", [[0.0, 0.0], [0.7, 0.3]])
def test_capsules_cover_every_shape_of_an_mjcf_wherever_it_is(shapes, q):
    capsules, rng = capsules_from_robot(shapes), np.random.default_rng(0)
    (ends,) = ends_in_world(shapes.chain, capsules, np.array([q]))
    model = mujoco.MjModel.from_xml_path(shapes.path)
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_kinematics(model, data)
    for g in range(model.ngeom):
        own = [k for k, x in enumerate(capsules.names) if x == model.geom(g).name]
        points = surface(model, data, g, rng)
        both = np.stack([points, points], axis=1)
        away = [
            np.linalg.norm(
                np.subtract(*closest_points(both, np.tile(ends[k], (len(both), 1, 1)))),
                axis=1,
            ) - capsules.radius[k]
            for k in own
        ]  # fmt: skip
        assert np.min(away, axis=0).max() < 1e-9, model.geom(g).name


def test_points_move_with_a_joint_that_slides_as_with_one_that_turns(shapes):
    chain, way = shapes.chain, np.array([[0.3, -0.5, 0.8]])
    q, local = np.array([[0.7, 0.3]]), np.array([0.1, 0.2, 0.3])

    def along(x):
        R, p, _ = frames(chain, x)
        return float(way[0] @ (R[1, 0] @ local + p[1, 0]))

    R, p, _ = frames(chain, q)
    found = point_change(chain, q, 1, (R[1, 0] @ local + p[1, 0])[None], way)
    step = 1e-6 * np.eye(2)[:, None]
    expected = [(along(q + s) - along(q - s)) / 2e-6 for s in step]
    np.testing.assert_allclose(found[0], expected, atol=1e-8)


def test_capsules_cover_every_point_of_a_mesh():
    import pinocchio as pin

    robot = public_arm("ur10")
    capsules = capsules_from_robot(robot)
    rotation, origin, _ = (x[:, 0] for x in frames(robot.chain, np.zeros((1, 6))))
    model = pin.buildModelFromUrdf(robot.path)
    root = robot.path.split("/example-robot-data/")[0]
    kind = pin.GeometryType.COLLISION
    geometry = pin.buildGeomFromUrdf(model, robot.path, kind, package_dirs=[root])
    data = model.createData()
    pin.forwardKinematics(model, data, pin.neutral(model))
    for item in geometry.geometryObjects[1:7]:
        link = item.parentJoint - 1
        place = data.oMi[item.parentJoint].act(item.placement)
        world = item.geometry.vertices() @ place.rotation.T + place.translation
        points = (world - origin[link]) @ rotation[link]
        own = capsules.link == link
        ends = np.stack([points, points], axis=1)[:, None]
        x, y = closest_points(np.repeat(ends, own.sum(), 1), capsules.ends[own][None])
        inside = np.linalg.norm(x - y, axis=2) - capsules.radius[own]
        assert inside.min(axis=1).max() < 1e-6


def test_frames_are_those_of_pinocchio():
    import pinocchio as pin

    model = COMAN.pinocchio()
    data = model.createData()
    q = np.random.default_rng(0).uniform(-2, 2, (4, 6))
    R, p, _ = frames(COMAN.chain, q)
    for k, posture in enumerate(q):
        pin.forwardKinematics(model, data, posture)
        for j in range(6):
            np.testing.assert_allclose(R[j, k], data.oMi[j + 1].rotation, atol=1e-12)
            np.testing.assert_allclose(p[j, k], data.oMi[j + 1].translation, atol=1e-12)


def clearance_of_coman(limits):
    with pytest.warns(HybridWarning, match="often: elbow and wrist_3"):
        return Clearance.of(COMAN, limits)


def test_links_whose_capsules_touch_almost_anywhere_are_left_out_and_named():
    limits = Limits.of(COMAN)
    clearance = clearance_of_coman(limits)
    q = np.random.default_rng(5).uniform(limits.low, limits.high, (500, 6))
    assert ((clearance.distance(q) < 0.01).mean(axis=0) < 0.4).all()
    assert [2, 5] not in clearance.links.tolist()
    assert [-1, 4] in clearance.links.tolist()


def test_links_without_geometry_are_left_out_and_named():
    robot = public_arm("z1")  # of seven links five have any
    with pytest.warns(HybridWarning, match="collision geometry: joint1, joint5"):
        clearance = Clearance.of(robot, Limits.of(robot))
    assert set(clearance.links.ravel()) == {-1, 1, 2, 3, 5, 6}
    distance = clearance.distance(np.zeros((2, robot.size)))
    assert distance.shape == (2, len(clearance.pairs))


@pytest.mark.parametrize("kind", ["clearance", "floor"])
def test_slopes_are_those_of_finite_differences(kind):
    limits = Limits.of(COMAN)
    capsules = capsules_from_robot(COMAN)
    constraint = {
        "clearance": clearance_of_coman(limits),
        "floor": Floor(COMAN, capsules, 0.1),
    }[kind]
    q = np.random.default_rng(1).uniform(limits.low, limits.high, (15, 6))
    for k in range(0, len(constraint.names), 5):
        slope = constraint.slope(still(q), np.full(15, k))
        assert np.abs(slope[:, 1:]).max() == 0
        for j in range(6):
            step = 1e-6 * np.eye(6)[j]
            ahead = constraint.excess(still(q + step))[:, k]
            change = ahead - constraint.excess(still(q - step))[:, k]
            np.testing.assert_allclose(slope[:, 0, j], change / 2e-6, atol=1e-6)


@pytest.mark.parametrize("name", ["coman_like.xml", "z1"])
def test_slopes_of_torque_are_those_of_finite_differences(name):
    robot = Robot.load(MODELS / name) if name.endswith("xml") else public_arm(name)
    n, rng = robot.size, np.random.default_rng(2)
    # Friction of every declared kind, a spring, a ripple, and a rotor of two joints.
    kinds = ("quadratic", "cubic", "damping", "frictionloss", "stiffness")
    own = {x: rng.uniform(0.5, 2.0, n) for x in kinds}
    own |= {"ripple": np.array([[1, 0.2, 0.1, 3.0]])}
    own |= {"coupled": np.array([[0, 1, 0.3, 0.7, 0.4]])}
    own |= {"falling": np.array([[1, 2.0, 0.5], [2, 1.0, 0.2]])}
    own |= {"knee": np.eye(n)[0], "knee_speed": np.full(n, 0.4)}
    robot = replace(robot, **own)
    constraint = TorqueLimits(robot, rng.uniform(10.0, 20.0, n))
    states = rng.normal(size=(3, 6, n))
    q, v, a = states[0], np.sign(states[1]), states[2]  # away from where joints turn
    whole = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a)
    whole += robot.joint_torque(q, v, a) + robot.dry_friction(v)
    np.testing.assert_allclose(constraint.torque(path_of(q, v, a)), whole, atol=1e-6)
    for k in range(2 * n):
        slope = constraint.slope(path_of(*states), np.full(6, k))
        assert np.abs(slope[:, 3]).max() == 0  # torque does not depend on the jerk
        for order in range(3):
            for j in range(n):
                step = np.zeros_like(states)
                step[order, :, j] = 1e-6
                ahead = constraint.excess(path_of(*states + step))[:, k]
                change = ahead - constraint.excess(path_of(*states - step))[:, k]
                expected = change / 2e-6
                np.testing.assert_allclose(slope[:, order, j], expected, atol=1e-6)


def test_a_design_keeps_links_apart_and_above_the_floor():
    planar = Robot.load(MODELS / "planar.xml")
    limits = Limits.of(planar)
    clearance = Clearance.of(planar, limits, margin=0.05)
    asked = planar, observe(planar.chain), Fourier(3, 0.2)
    options = {"criterion": Condition(), "starts": 2}
    free = design(*asked, **options)
    height = 0.05 + lowest(planar, clearance, free)
    floor = Floor(planar, clearance.capsules, height)
    kept = design(*asked, **options, constraints=(clearance, floor))
    assert lowest(planar, clearance, kept) >= height
    q = kept.trajectories[0].path(uniform(5.0, 333.0)).q
    assert clearance.distance(q).min(initial=1.0) >= 0.0499
    assert kept.condition >= free.condition * 0.99  # the floor costs something


def lowest(robot, clearance, result):
    """Lowest height of the moving links along a designed motion."""
    q = result.trajectories[0].path(uniform(5.0, 333.0)).q
    moving = clearance.capsules.link >= 1
    ends = ends_in_world(robot.chain, clearance.capsules, q)[:, moving]
    return (ends[..., 2] - clearance.capsules.radius[moving, None]).min()


def test_a_floor_that_is_too_high_is_named():
    limits = Limits.of(COMAN)
    floor = Floor(COMAN, capsules_from_robot(COMAN), 2.0)
    with pytest.raises(ExcitationError, match="no posture keeps the lowest z"):
        design(
            COMAN,
            observe(COMAN.chain),
            Fourier(3, 0.1),
            seed=np.random.default_rng(0),
            limits=limits,
            constraints=(floor,),
        )


def test_a_robot_without_geometry_cannot_be_checked(tmp_path):
    text = (MODELS / "planar.xml").read_text()
    lines = [x for x in text.splitlines() if "<geom" not in x and "<exclude" not in x]
    (tmp_path / "bare.xml").write_text("\n".join(lines))
    robot = Robot.load(tmp_path / "bare.xml")
    with pytest.raises(RobotError, match="no collision geometry"):
        capsules_from_robot(robot)


def test_only_links_that_are_no_neighbours_are_kept_apart(monkeypatch):
    """Neighbours share a joint, however far from it their shapes are."""
    robot = pendulum(3)
    middle = np.tile([0.0, 0.0, -0.3], (4, 2, 1))
    middle[0] = 0.0, 0.0, 0.3  # of the base
    capsules = Capsules(np.arange(-1, 3), middle, np.full(4, 0.05), tuple("abcd"))
    monkeypatch.setattr(
        "hybrid.excitation.clearance.capsules_from_robot", lambda _: capsules
    )
    kept = Clearance.of(robot, Limits.of(robot))
    assert kept.links.tolist() == [[-1, 1], [-1, 2], [0, 2]]


def hanging(radius=0.05):
    """Three rods that hang from one another; one capsule each, and one of the base."""
    ends = np.tile([[0.0, 0.0, 0.0], [0.0, 0.0, -0.5]], (4, 1, 1))
    ends[0] += [0.0, 0.0, 0.7]
    return Capsules(np.arange(-1, 3), ends, np.full(4, radius), tuple("abcd"))


def rods(q):
    """Start and end of each rod in the plane that they swing in, shape (3, 2, N, 2)."""
    angle = np.cumsum(q, axis=1)
    way = [np.stack([-np.sin(x), -np.cos(x)], axis=1) for x in angle.T]
    start = [0 * way[0], 0.6 * way[0], 0.6 * (way[0] + way[1])]
    return np.array([[x, x + 0.5 * y] for x, y in zip(start, way, strict=True)])


def test_a_floor_is_below_both_ends_of_every_moving_link_by_its_radius():
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (7, 3))
    floor = Floor(pendulum(3), hanging(), -1.5)
    z = rods(q)[1:, :, :, 1].reshape(4, 7).T
    np.testing.assert_allclose(floor.excess(still(q)), (-1.5 + 0.05 - z) / 0.2)
    assert floor.names == tuple(
        f"lowest z of the link of hinge_{k}" for k in (1, 1, 2, 2)
    )


def test_links_are_as_far_apart_as_their_closest_points_less_both_radii():
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (9, 3))
    pairs = np.array([[0, 2], [1, 3]])
    kept = Clearance(pendulum(3), hanging(), pairs, 0.02)
    share = np.linspace(0.0, 1.0, 201)[:, None, None]

    def points(start, end):
        return start + share * (end - start)

    links = rods(q)
    base = np.array([[[0.0, 0.7]] * 9, [[0.0, 0.2]] * 9])
    expected = []
    for first, second in ((base, links[1]), (links[0], links[2])):
        between = points(*first)[:, None] - points(*second)[None]
        least = np.linalg.norm(between, axis=3).min(axis=(0, 1))
        expected.append(least - 0.1)
    found = kept.distance(q)
    np.testing.assert_allclose(found, np.transpose(expected), atol=3e-3)
    excess = (0.02 - found) / 0.2
    np.testing.assert_allclose(kept.excess(still(q)), excess)
    assert kept.names == tuple(
        f"closeness of the links of {x}"
        for x in ("base and hinge_1", "hinge_0 and hinge_2")
    )
    none = Clearance(pendulum(3), hanging(), np.zeros((0, 2), dtype=int), 0.02)
    assert none.distance(q).shape == (9, 0)


@pytest.mark.parametrize(
    ("touching", "kept", "named"),
    [(90, True, False), (91, False, True), (284, False, True), (285, False, False)],
)
def test_links_that_often_touch_are_named_and_those_that_always_do_are_not(
    touching, kept, named, monkeypatch, recwarn
):
    """From three tenths of the postures on, and from nineteen twentieths on."""
    monkeypatch.setattr(
        "hybrid.excitation.clearance.capsules_from_robot", lambda _: hanging()
    )

    def distance(self, q):
        near = np.arange(len(q)) < touching
        return np.where(near, 0.0099, 0.0101)[:, None] * np.ones(len(self.pairs))

    monkeypatch.setattr(Clearance, "distance", distance)
    robot = pendulum(3)
    found = Clearance.of(robot, Limits.of(robot))
    assert len(found.pairs) == 3 * kept and found.margin == 0.01
    said = [str(w.message) for w in recwarn]
    often = "base and hinge_1, base and hinge_2, hinge_0 and hinge_2"
    lines = [f"not kept apart, as their capsules touch too often: {often}"]
    assert said == lines * named
    assert all(w.filename == __file__ for w in recwarn)  # where it was asked for


def test_a_link_without_geometry_is_named_where_it_was_asked_for(monkeypatch, recwarn):
    whole, kept = hanging(), [0, 1, 3]
    few = Capsules(whole.link[kept], whole.ends[kept], whole.radius[kept], tuple("abd"))
    monkeypatch.setattr(
        "hybrid.excitation.clearance.capsules_from_robot", lambda _: few
    )
    found = Clearance.of(pendulum(3), Limits.of(pendulum(3)), margin=-1.0)
    assert found.links.tolist() == [[-1, 2], [0, 2]]
    (said,) = recwarn
    words = "not kept apart, without collision geometry: hinge_1"
    assert (str(said.message), said.filename) == (words, __file__)
