"""Capsules, inertias, geometry and actuators of robot files, at their edges."""

import xml.etree.ElementTree as ET
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hybrid.errors import RobotError
from hybrid.recording.units import converted, fits, seconds
from hybrid.robot.build import _set_inertia, simulable
from hybrid.robot.edit.drives import _edit, actuator_tags
from hybrid.robot.edit.urdf_from_mjcf import _Writer
from hybrid.robot.geometry import (
    _capsule_along,
    _covering,
    _halved,
    _pieces,
    _points,
)
from hybrid.robot.spatial import inertia_fault, inertial_about, link_spread

# --- capsules -------------------------------------------------------------------------


def test_one_point_and_two_have_a_capsule_without_a_width():
    ends, radius = _covering(np.array([[1.0, 2.0, 3.0]]))
    assert radius == 0.0 and ends.tolist() == [[1.0, 2.0, 3.0]] * 2
    two = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    ends, radius = _covering(two)
    assert radius == 0.0 and ends.tolist() == two.tolist()
    corner = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert _covering(corner)[1] > 0.3


@given(seed=st.integers(0, 10**6), count=st.integers(3, 30))
@settings(max_examples=20)
def test_every_point_is_in_its_capsule(seed, count):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3)) * [1.0, 0.3, 0.1]
    (start, end), radius = _covering(points)
    way = end - start
    share = (points - start) @ way / max(way @ way, 1e-300)
    near = start + np.clip(share, 0.0, 1.0)[:, None] * way
    assert np.linalg.norm(points - near, axis=1).max() <= radius * (1 + 1e-9) + 1e-9


def test_a_capsule_across_a_disk_has_its_width():
    flat = np.array([[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, -1.0, 0]])
    ends, radius = _capsule_along(flat, np.array([0.0, 0.0, 1.0]))
    assert radius == pytest.approx(1.0, rel=2e-2) and np.ptp(ends[:, 2]) < 0.2


def test_a_cylinder_lies_within_its_polygon():
    rim, _ = _points("cylinder", 2.0, 0.5, np.zeros(3))
    assert len(rim) == 32 and set(rim[:, 2]) == {-0.5, 0.5}
    edge = (rim[:16] + np.roll(rim[:16], 1, axis=0))[:, :2] / 2
    np.testing.assert_allclose(np.linalg.norm(edge, axis=1), 2.0)


def test_a_triangle_is_cut_at_the_middle_of_its_longest_edge():
    """A long and a short one, of which the first is cut."""
    corners = np.array([
        [[0.0, 0, 0], [2.0, 0, 0], [0.0, 1.0, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
    ], dtype=float)  # fmt: skip
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    first, second = _halved(corners, edges, np.array([True, False]))
    both = np.concatenate([first, second])
    assert {tuple(x) for x in both} == {
        (0, 0, 0), (2, 0, 0), (0, 1, 0), (1, 0.5, 0),
    }  # fmt: skip
    area = [np.linalg.norm(np.cross(x[1] - x[0], x[2] - x[0])) for x in (first, second)]
    np.testing.assert_allclose(area, 1.0)  # half of two


def test_a_mesh_is_cut_and_split_in_two():
    square = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.01, 0], [0, 0.01, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    left, right = sorted(_pieces(square, triangles), key=lambda x: x[:, 0].mean())
    assert left[:, 0].max() < 0.08 and right[:, 0].min() > 0.02
    both = np.concatenate([left, right]).reshape(-1, 3, 3)
    edges = np.linalg.norm(both - np.roll(both, 1, axis=1), axis=2)
    assert edges.max() <= 0.03
    area = np.linalg.norm(np.cross(both[:, 1] - both[:, 0], both[:, 2] - both[:, 0]),
                          axis=1).sum() / 2  # fmt: skip
    assert area == pytest.approx(0.1 * 0.01)
    (one,) = _pieces(0.1 * square[:3], triangles[:1])
    np.testing.assert_array_equal(one, 0.1 * square[:3])
    (cloud,) = _pieces(square, triangles[:0])
    assert cloud is square


# --- inertias -------------------------------------------------------------------------


def test_what_has_no_mass_is_given_a_little():
    mass, _, found = simulable(0.0, np.zeros(3), np.zeros((3, 3)))
    assert 0 < mass < 1e-3 and (np.diag(found) > 0).all()
    assert not found[~np.eye(3, dtype=bool)].any()


# --- URDF of an MJCF file -------------------------------------------------------------


def shapes(geom):
    """Poses and elements of a geom of an MJCF file."""
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{geom}</worldbody></mujoco>"
    )
    made = SimpleNamespace(model=model, missing={})
    R, p = np.eye(3), np.array([1.0, 2.0, 3.0])
    return list(_Writer._shapes(made, 0, R, p)), made.missing


def test_a_capsule_is_a_cylinder_with_a_ball_at_either_end():
    found, _ = shapes("<geom type='capsule' size='.1 .4'/>")
    tube, *balls = (ET.fromstring(x) for _, _, x in found)
    assert tube.tag == "cylinder" and float(tube.get("length")) == pytest.approx(0.8)
    assert [float(x.get("radius")) for x in (tube, *balls)] == pytest.approx([0.1] * 3)
    at = [p.tolist() for _, p, _ in found]
    assert at == [[1, 2, 3], [1, 2, pytest.approx(3.4)], [1, 2, pytest.approx(2.6)]]


def test_a_box_has_whole_lengths_and_an_ellipsoid_is_missed():
    ((_, _, box),), _ = shapes("<geom type='box' size='.1 .2 .3'/>")
    size = [float(x) for x in ET.fromstring(box).get("size").split()]
    assert size == pytest.approx([0.2, 0.4, 0.6])
    found, missing = shapes("<geom type='ellipsoid' size='.1 .2 .3'/>")
    assert found == [] and missing == {"ellipsoid geoms": 1}


# --- actuators ------------------------------------------------------------------------


def edited(actuator, **change):
    """What is set of an actuator, and what it cannot express."""
    text = (
        "<mujoco><worldbody><body><geom size='.1'/><joint name='j'/></body></worldbody>"
        f"<actuator>{actuator}</actuator></mujoco>"
    )
    model = mujoco.MjModel.from_xml_string(text)
    tag = SimpleNamespace(attributes={}, path=("mujoco", "actuator", "general"))
    set_, usual = {}, {"latency": 0.0, "limit": np.inf, "stiffness": 1.0,
                       "damping": 1.0, "gain": 1.0, "lag": 0.0}  # fmt: skip

    class Document:
        def set(self, tag, given, **_):
            set_.update(given)

    new = SimpleNamespace(**{**usual, **change})
    gear = float(model.actuator_gear[0, 0])
    missing = list(_edit(Document(), model, 0, gear, tag, new))
    return set_, missing


MOTOR = "<motor joint='j' gear='2'/>"
SERVO = "<position joint='j' kp='50' kv='3'/>"
SPEED = "<velocity joint='j' kv='4'/>"


def test_a_servo_has_other_gains_and_a_motor_has_none():
    found, missing = edited(SERVO, stiffness=0.5, damping=2.0)
    assert missing == [] and found["gainprm"] == 25.0
    np.testing.assert_allclose(found["biasprm"], [0.0, -25.0, -6.0])
    found, missing = edited(SPEED, damping=2.0)
    assert missing == [] and found["gainprm"] == 8.0
    np.testing.assert_allclose(found["biasprm"], [0.0, 0.0, -8.0])
    found, missing = edited(MOTOR, stiffness=0.5)
    assert missing == ["gains of a servo"] and found == {}
    assert edited(MOTOR) == ({}, []) and edited(SERVO) == ({}, [])


def test_a_drive_has_another_gain_limit_lag_and_latency():
    found, _ = edited(MOTOR, gain=1.5)
    assert found == {"gaintype": "fixed", "gainprm": 1.5}
    found, _ = edited(MOTOR, limit=8.0)
    assert found == {"forcelimited": "true", "forcerange": (-4.0, 4.0)}
    narrow = "<motor joint='j' gear='2' forcelimited='true' forcerange='-3 3'/>"
    assert edited(narrow, limit=8.0)[0]["forcerange"] == (-3.0, 3.0)
    found, _ = edited(MOTOR, lag=0.02)
    assert (found["dyntype"], found["dynprm"]) == ("filter", 0.02)
    filtered = "<general joint='j' dyntype='filter' dynprm='0.1'/>"
    assert edited(filtered, lag=0.02) == ({}, ["a lag"])
    found, _ = edited(MOTOR, latency=0.005)
    assert found == {"delay": 0.005, "nsample": 4, "interp": "linear"}  # 3 of 2 ms
    muscle = "<muscle joint='j' timeconst='0.01 0.04' lengthrange='0.1 1'/>"
    assert edited(muscle, gain=2.0)[1] == ["a change of the torque"]


def test_tags_of_actuators_are_those_of_the_joint():
    def tag(kind="motor", parent="actuator", **given):
        return SimpleNamespace(path=("mujoco", parent, kind), attributes=given)

    own = [tag(joint="j"), tag(jointinparent="j")]
    others = [
        tag(joint="k"), tag(parent="default", joint="j"), tag("joint", joint="j"),
        tag(joint="j", input="none"),
    ]  # fmt: skip
    assert actuator_tags(SimpleNamespace(tags=[*own, *others]), "j") == own


# --- units ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "channel", "factor", "offset"),
    [
        ("deg", "q", np.pi / 180, 0.0), ("mm", "q", 1e-3, 0.0), ("ms", "time", 1e-3, 0),
        ("deg/s", "v", np.pi / 180, 0.0), ("mNm", "tau", 1e-3, 0.0),
        ("Ncm", "tau", 1e-2, 0.0), ("kN", "tau", 1e3, 0.0),
        ("degC", "temperature", 1.0, 0.0),
        ("kelvin", "temperature", 1.0, -273.15), ("mA", "current", 1e-3, 0.0),
        (" rad ", "q", 1.0, 0.0), ("N·m", "tau", 1.0, 0.0),
    ],
)  # fmt: skip
def test_units_are_converted_to_si(unit, channel, factor, offset):
    found = converted(unit, channel)
    assert found == pytest.approx((factor, offset), rel=1e-9, abs=1e-9)
    assert fits(unit) and fits(unit, channel)


@pytest.mark.parametrize(
    ("unit", "channel"),
    [("s", "q"), ("Nm", "q"), ("count", "q"), ("", "q"), ("1", "q")],
)
def test_what_is_no_unit_of_a_channel_is_none(unit, channel):
    assert converted(unit, channel) is None and not fits(unit, channel)


def test_clocks_are_in_seconds_by_their_unit_or_by_their_size():
    x = np.array([3, 4, 6])
    for unit, size in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        found, same = seconds(x, unit)
        np.testing.assert_allclose(found, x * size, rtol=1e-15)
        assert same == unit
    found, unit = seconds(x, "")
    assert unit == "s" and found.tolist() == [3.0, 4.0, 6.0]
    late = 1_700_000_000
    for size, name in ((1e3, "ms"), (1e6, "us"), (1e9, "ns")):
        found, unit = seconds((late * size + x * size).astype(np.int64), "")
        assert unit == name and found.tolist() == [0.0, 1.0, 3.0]
    found, unit = seconds(late + x.astype(float), "")
    assert unit == "s" and found[0] == late + 3.0
    for first, unit in ((0.99e9, "s"), (1.01e12, "ms"), (4.1e12, "ms"), (4.3e12, "s")):
        assert seconds(np.array([first, first + 1.0]), "")[1] == unit
    stamps = np.array(
        ["2024-01-01T00:00:00", "2024-01-01T00:00:01.5"], "datetime64[ns]"
    )
    found, unit = seconds(stamps, "")
    assert unit == "ns" and found.tolist() == [0.0, 1.5]
    # A third of a millisecond is divided by three, and has no rounding error.
    exact, _ = seconds(np.array([1, 3]), "ms")
    assert exact.tolist() == [1 / 1000, 3 / 1000]
    minutes, _ = seconds(np.array([2.0]), "min")
    assert minutes.tolist() == [120.0]


def test_a_light_link_may_have_a_moment_of_a_millionth_below_zero():
    """A heavier one has it per kilogram."""
    for mass, least in ((0.5, -1e-6), (3.0, -3e-6)):
        for share, valid in ((0.9, True), (1.1, False)):
            body = mujoco.MjSpec().worldbody.add_body()
            link = np.array([mass, 0, 0, 0, share * least, 0, 0.1, 0, 0, 0.1])
            if valid:
                _set_inertia(body, link, "tip")
                assert body.mass == mass
                continue
            with pytest.raises(RobotError, match="link 'tip' has no physical inertia"):
                _set_inertia(body, link, "tip")


def test_an_inertia_that_is_no_number_has_three_moments_that_are_none():
    text = inertia_fault(1.0, np.full((3, 3), np.nan))
    assert "(mass 1 kg, moments nan, nan, nan kg·m²)" in text


def test_links_are_off_by_their_mass_their_centre_and_their_width():
    """The centre is so by its distance, and by a third of the radius of gyration."""
    about = np.diag([0.02, 0.03, 0.01])
    link = inertial_about(2.0, np.array([0.3, 0.0, -0.01]), about)
    found = link_spread(np.array([link, np.zeros(10)]))
    moments = 3 * [2.0 * np.hypot(0.3, 0.01)]
    inertia = 0.03 / 2 + 2.0 * (0.3**2 + 0.01**2) + 1e-9
    np.testing.assert_allclose(found[0], [2.0, *moments, *[inertia] * 6])
    assert not found[1].any()
    point = link_spread(inertial_about(2.0, np.zeros(3), np.zeros((3, 3)))[None])
    np.testing.assert_allclose(point[0], [2.0, *[2e-4 / 3] * 3, *[1e-9] * 6])
    turn = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
    turned = inertial_about(2.0, turn @ [0.3, 0.0, -0.01], turn @ about @ turn.T)
    np.testing.assert_allclose(link_spread(turned[None])[0], found[0])


@pytest.mark.parametrize(
    ("moments", "fault"),
    [((1.0, 1.0, 2.0 + 2.9e-5), False), ((1.0, 1.0, 2.0 + 3.1e-5), True),
     ((-1.4e-14, 1e-10, 1e-10), False), ((-1.6e-14, 1e-10, 1e-10), True),
     ((0.0, 0.0, 0.0), False), ((np.inf, 1.0, 1.0), True)],
)  # fmt: skip
def test_moments_may_be_off_by_the_rounding_of_six_digits(moments, fault):
    assert bool(inertia_fault(1.0, np.diag(moments))) == fault
    assert inertia_fault(-1e-9, np.eye(3)).startswith(
        "has no physical inertia (mass -1"
    )
    assert not inertia_fault(0.0, np.eye(3))
