"""Every law at numbers worked out by hand, and every hook beside the law."""

from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from arms import MODELS, random_arm
from coarse import Plant
from hypothesis import given, settings
from hypothesis import strategies as st
from loop import Loop, commanded_torque
from pendulum import pendulum
from test_effect_laws import effect, motion_of

from hybrid.dynamics import RigidBody
from hybrid.effects import JointState, Scale, effect_class, effect_classes
from hybrid.effects.backlash import _flight, _link_position
from hybrid.effects.delivered import Drive
from hybrid.effects.elasticity import _swing
from hybrid.effects.gravity_tilt import level_axes
from hybrid.errors import EffectError
from hybrid.plant import Noise
from hybrid.robot import Robot
from hybrid.signals import Motion


def columns_at(name, q=0.5, v=-2.0, a=3.0, load=-4.0, **values):
    """Columns of a joint's law at one state."""
    law = effect(name, **values)
    q, v, a, load = (np.array([float(x)]) for x in (q, v, a, load))
    state = JointState(0 * q, q, v, a, np.sign(v), load)
    return [float(x[0]) for x in law.law(state, **law.shape_values)]


def rigid(robot, motion):
    return RigidBody(robot.chain, motion)


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("armature", {}, [3.0]),
        ("coulomb", {}, [-1.0]),
        ("viscous", {}, [-2.0]),
        ("torque_offset", {}, [1.0]),
        ("asymmetric_friction", {}, [1.0]),
        ("load_friction", {}, [-4.0]),
        ("nonlinear_viscous", {}, [-4.0, -8.0]),
        ("spring", {}, [0.5, 1.0]),
        ("stiffening_spring", {"rest": -0.5, "knee": 2.0}, [1.25]),
        ("torque_ripple", {"periods": 3.0}, [np.sin(1.5), np.cos(1.5)]),
        ("stribeck", {"velocity": 0.8, "exponent": 1.0}, [-np.exp(-2.5)]),
        ("stribeck", {"velocity": 0.8, "exponent": 2.0}, [-np.exp(-6.25)]),
        (
            "counterbalance",
            {"dead_centre": 0.2, "crank_ratio": 0.4},
            [np.sin(0.3), np.sin(0.3) / np.sqrt(1.16 - 0.8 * np.cos(0.3))],
        ),
    ],
)
def test_a_law_is_its_formula(name, values, expected):
    np.testing.assert_allclose(columns_at(name, **values), expected, rtol=1e-12)


@given(st.floats(0.1, 5.0), st.floats(0.0, 20.0), st.sampled_from([-1.0, 1.0]))
def test_a_polynomial_of_speed_goes_on_as_its_tangent(fastest, beyond, way):
    inside = columns_at("nonlinear_viscous", v=way * fastest, fastest=fastest)
    outside = columns_at(
        "nonlinear_viscous", v=way * (fastest + beyond), fastest=fastest
    )
    powers = np.array([2, 3])
    slope = powers * fastest ** (powers - 1)
    np.testing.assert_allclose(inside, way * fastest**powers, rtol=1e-12)
    np.testing.assert_allclose(outside, inside + way * slope * beyond, rtol=1e-9)


# --- drives ---------------------------------------------------------------------------


def test_a_saturated_drive_is_asked_for_what_makes_up_its_loss():
    law = effect("saturation", loss=0.5, limit=10.0)
    np.testing.assert_array_equal(
        law.deliver(np.array([8.0, 14.0, -14.0])), [8, 12, -12]
    )
    (asked,), _ = law.report_at_instant([12.0], (), 0.001)
    assert asked == 14.0
    for loss, extra in ((0.89, 0.89 / 0.11), (0.9, 0.0)):
        clips = effect("saturation", loss=loss, limit=10.0)
        assert clips.report_at_instant([11.0], (), 0.1)[0][0] == pytest.approx(
            11 + extra
        )


def test_a_fitted_loss_is_reported_as_that_of_the_torque_asked_for():
    soft = effect("saturation", loss=0.25).as_reported()
    assert soft.values["loss"] == pytest.approx(0.2)
    clips = effect("saturation", loss=0.25, total=1.0).as_reported()
    assert clips.values["loss"] == 0.25 and clips.values["total"] == 0.0


def test_of_a_drive_that_clips_or_has_a_dead_zone_most_must_be_lost():
    assert effect("saturation", total=1.0).least_gains == [0.8]
    assert effect("saturation").least_gains == [0.0]
    assert effect("deadzone", onset=2.0, total=1.0).least_gains == [1.6]
    assert effect("deadzone", onset=2.0).least_gains == [1.6]


def drive(asked, tau, v=None):
    """A motion of one joint at which torque was asked for and another delivered."""
    n = len(asked)
    t = 0.01 * np.arange(n)
    v = np.cos(t)[:, None] if v is None else v
    column = [np.asarray(x, dtype=float).reshape(n, 1) for x in (asked, tau)]
    zero = np.zeros((n, 1))
    return Motion(t, zero, v, zero, column[1], np.ones(n, bool), asked=column[0])


def test_a_limit_is_suggested_where_clearly_more_is_asked_for_than_delivered():
    asked = 30.0 * np.sin(np.linspace(0, 40, 2000))
    cls = effect_class("saturation")
    found = cls.suggested([drive(asked, np.clip(asked, -12, 12))], 0)
    assert found == {"limit": pytest.approx(12.0), "total": 1.0}
    assert cls.suggested([drive(asked, asked)], 0) == {}
    assert cls.suggested([drive(asked, asked / 1.05)], 0) == {}
    few = slice(0, 99)
    assert cls.suggested([drive(asked[few], np.clip(asked[few], -12, 12))], 0) == {}
    assert cls.suggested([replace(drive(asked, asked), asked=None)], 0) == {}
    assert cls.suggested([], 0) == {}


@pytest.mark.parametrize(("periods", "holds"), [(4.1, True), (3.9, False)])
def test_a_ripple_repeats_within_a_motion(periods, holds):
    """The longer of two motions is a quarter of a turn."""
    still = drive(np.zeros(50), np.zeros(50))
    way = np.linspace(0.3, 0.3 + np.pi / 2, 50)[:, None]
    law = effect("torque_ripple", periods=periods)
    assert law.holds([still, replace(still, q=way)]) == holds
    assert not law.holds([still])


def test_a_suggested_limit_contains_the_friction_that_the_file_lacks():
    asked = 30.0 * np.sin(np.linspace(0, 40, 2000))
    v = np.cos(np.linspace(0, 13, 2000))
    friction = 4.0 * np.sign(v) + 2.0 * v
    by_file = np.clip(asked, -12, 12) - friction
    found = effect_class("saturation").suggested([drive(asked, by_file, v[:, None])], 0)
    assert found["limit"] == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize(
    "name",
    [
        "presliding", "thermal_friction", "friction_lag", "saturation",
        "stiffening_spring",
    ],
)  # fmt: skip
def test_an_effect_is_the_law_that_it_becomes_at_its_limit(name):
    """To a few per cent, up to a factor; the plainer law has a size of its own."""
    scale = Scale(30.0, 2.0)
    limit, plain = effect_class(name).typical((0,), [scale]).at_limit(scale)
    t = np.arange(0.0, 4.0, 0.001)
    q, v, a = np.sin(2 * t), 2 * np.cos(2 * t), -4 * np.sin(2 * t)
    tau = 20.0 * np.sin(2 * t + 0.3)
    motion = Motion(
        t, q[:, None], v[:, None], a[:, None], tau[:, None], np.full(len(t), True)
    )
    both = limit, effect_class(plain)((0,))
    body = SimpleNamespace(load=motion.tau)  # what the drive gives, the arm takes
    one, other = (x.columns(motion, body)[:, 0, 0] for x in both)
    part = one @ other / np.sqrt((one @ one) * (other @ other))
    assert abs(part) > 0.97


def test_a_drive_clips_only_near_its_limit():
    asked = 30.0 * np.sin(np.linspace(0, 40, 2000))
    motion = drive(asked, np.clip(asked, -12, 12))
    assert effect("saturation", limit=12.0, total=1.0).holds([motion])
    assert effect("saturation", limit=14.0, total=1.0).holds([motion])
    assert not effect("saturation", limit=16.0, total=1.0).holds([motion])
    assert not effect("saturation", limit=9.0, total=1.0).holds([motion])
    assert effect("saturation", limit=9.0).holds([motion])


def test_what_is_delivered_has_the_friction_that_a_file_lacks():
    """It is learned where the drive loses nothing, or beside what it loses there."""
    t = np.linspace(0, 40, 2000)
    asked, v, a = 30.0 * np.sin(t), np.cos(1.7 * t), -1.7 * np.sin(1.7 * t)
    lacks = 3.0 * np.sign(v) + 2.0 * v + 0.5 * a
    clipped, through = np.clip(asked, -12, 12), asked - 4.0 * np.sign(asked)
    for delivered, use, lost in (
        (clipped, np.abs(asked) < 12, ()),
        (through, np.abs(asked) > 4, (np.sign(asked),)),
    ):
        found = Drive(v, a, delivered - lacks, asked).delivered(use, *lost)
        np.testing.assert_allclose(found, delivered, atol=1e-9)
    few = np.arange(2000) < 99
    np.testing.assert_array_equal(
        Drive(v, a, clipped - lacks, asked).delivered(few), clipped - lacks
    )


def test_torque_beyond_a_limit_is_seen_in_the_log_or_in_what_was_asked():
    asked = 30.0 * np.sin(np.linspace(0, 40, 500))
    motion = drive(asked, np.clip(asked, -12, 12))
    beyond = asked - np.clip(asked, -12, 12)
    part = effect("saturation", limit=12.0).columns(motion, None)[:, 0, 0]
    np.testing.assert_allclose(part, 0.0, atol=1e-12)
    inner = effect("saturation", limit=10.0).columns(motion, None)[:, 0, 0]
    assert np.abs(inner).max() == pytest.approx(2.0)
    clips = effect("saturation", limit=12.0, total=1.0).columns(motion, None)[:, 0, 0]
    np.testing.assert_allclose(clips, beyond)


def test_a_dead_zone_lets_through_what_exceeds_it():
    law = effect("deadzone", width=2.0)
    np.testing.assert_array_equal(law.deliver(np.array([1.0, 5.0, -5.0])), [0, 3, -3])
    (asked,), _ = law.report_at_instant([3.0], (), 0.001)
    assert asked == 5.0
    # To get through, a twentieth of its width is taken: no jump at rest.
    assert law.report_at_instant([0.05], (), 0.001)[0][0] == pytest.approx(1.05)
    assert law.report_at_instant([-0.2], (), 0.001)[0][0] == pytest.approx(-2.2)


def test_the_direction_of_torque_is_that_beyond_its_onset():
    tau = np.linspace(-10, 10, 401)
    law = effect("deadzone", onset=2.0)
    direction = np.clip(tau / 2.0, -1, 1)
    log = replace(drive(tau, tau), asked=None)
    np.testing.assert_allclose(law.columns(log, None)[:, 0, 0], direction)
    np.testing.assert_allclose(law.columns(drive(tau, tau), None)[:, 0, 0], direction)
    # Where torque is hardly ever above the onset, it is a gain.
    small = np.where(np.arange(401) < 150, tau, 0.1)
    assert law.holds([drive(tau, tau)]) and law.holds([log])
    assert not law.holds([drive(tau, small)])


def test_the_direction_of_torque_has_no_noise_and_not_the_friction_of_the_file():
    t = np.linspace(0, 60, 3000)
    v = np.cos(1.7 * t)
    link, noise = 10.0 * np.sin(t), np.random.default_rng(1).normal(0, 3.0, 3000)
    asked, wrong = link + 0.5 * np.sign(v), link + 5.0 * np.sign(v)
    law = effect("deadzone", onset=2.0)
    found = law.columns(drive(asked + noise, wrong, v[:, None]), None)[:, 0, 0]
    assert np.sqrt(np.mean((found - np.clip(asked / 2.0, -1, 1)) ** 2)) < 0.05
    # With friction alone both are outside the zone only by what the file has too much.
    friction = drive(0.5 * np.sign(v) + noise, 5.0 * np.sign(v), v[:, None])
    assert law.holds([drive(asked + noise, wrong, v[:, None])])
    assert not law.holds([friction])


def test_a_dead_zone_is_sure_where_nothing_comes_through_and_it_is_soon_crossed():
    t = np.linspace(0, 60, 3000)
    asked = 20.0 * np.sin(t)
    through = np.where(np.abs(asked) < 2.0, 0.0, asked)
    law = effect("deadzone", onset=2.0, total=1.0)
    sure = law.columns(drive(asked, through), None)[:, 0, 0]
    np.testing.assert_allclose(sure, np.clip(asked / 2.0, -1, 1))
    assert law.holds([drive(asked, through)])
    assert not law.holds([drive(asked, asked)])  # it comes through
    slow = np.where(np.sin(t) > 0.3, 20.0, 1.0)  # it stays inside for long
    assert not law.holds([drive(slow, np.where(slow > 2, slow, 0))])


def test_a_dead_zone_is_found_beside_friction_that_the_file_lacks():
    t = np.linspace(0, 60, 3000)
    asked, v = 20.0 * np.sin(t), np.cos(1.7 * t)
    through = asked - np.clip(asked, -2.0, 2.0)
    lacks = 5.0 * np.sign(v) + 2.0 * v
    law = effect("deadzone", onset=2.0, total=1.0)
    assert law.holds([drive(asked, through - lacks, v[:, None])])
    assert not law.holds([drive(asked, asked - lacks, v[:, None])])


def test_a_log_that_never_enters_a_dead_zone_says_nothing_against_it():
    """A law holds for all logs or for none: it foretells those that hardly show it."""
    t = np.linspace(0, 60, 3000)
    asked = 20.0 * np.sin(t)
    crosses = drive(asked, np.where(np.abs(asked) < 2.0, 0.0, asked))
    beyond = drive(np.abs(asked) + 2.1, np.abs(asked))
    one = np.append(np.abs(asked[:-1]) + 2.1, 1.9)  # one sample within
    once = drive(one, np.append(np.abs(asked[:-1]), 1.0))
    law = effect("deadzone", onset=2.0, total=1.0)
    assert law.holds([crosses, beyond]) and law.holds([crosses, once])
    assert not law.holds([beyond]) and not law.holds([once])


def test_a_servo_has_its_gains_off_by_a_part():
    law = effect("controller_gain", stiffness=0.5, damping=-0.25)
    assert law.actuator == {"stiffness": 1.5, "damping": 0.75}
    t = np.linspace(0, 1, 11)
    q, n = np.sin(t)[:, None], 11
    loop = Loop(
        t, q + 0.1, q + 0.2, 0 * q + 3.0, q, q, np.array([10.0]), np.array([4.0])
    )
    np.testing.assert_allclose(commanded_torque(loop), np.full((n, 1), 4.8))
    np.testing.assert_allclose(
        commanded_torque(loop, [law]), np.full((n, 1), 3 + 1.5 + 0.6)
    )


def test_a_late_command_is_that_of_before_and_is_held_at_the_start():
    t = np.linspace(0, 1, 101)
    law = effect("command_latency", time=0.1)
    plant = Plant(pendulum(1), [law], noise=Noise.none(1))
    seen = plant._commanded(t, t[:, None] ** 2)[:, 0]
    np.testing.assert_allclose(seen[10:], t[:-10] ** 2, atol=1e-12)
    np.testing.assert_array_equal(seen[:11], 0.0)


def test_late_torque_is_that_of_before():
    t = np.linspace(0, 1, 101)
    for time in (0.05, -0.05):
        found = effect("delay", time=time).report(t, np.stack([t, 3 * t], axis=1))
        inner = slice(5, -5)
        expected = np.stack([t - time, 3 * (t - time)], axis=1)
        np.testing.assert_allclose(found[inner], expected[inner], atol=1e-12)


@pytest.mark.parametrize("time", [0.02, -0.02])
def test_a_lag_at_each_instant_is_the_lag_of_the_whole(time):
    step = 0.001
    t = np.arange(0, 1, step)
    torque = np.sin(6 * t) + 0.2
    law = effect("actuator_lag", time=time)
    memory, shown = law.begin([None]), []
    for x in torque:
        (y,), memory = law.report_at_instant([x], memory, step)
        shown.append(float(y))
    whole = law.report(t, torque[:, None])[:, 0]
    tolerance = 1e-9 if time < 0 else 0.5 * time * 36 * step * 1.1
    np.testing.assert_allclose(shown[1:], whole[1:], atol=tolerance)
    assert law.actuator.get("lag", 0.0) == max(time, 0.0)


def test_presliding_in_the_plant_is_that_of_the_path():
    law = effect("presliding", level=5.0, distance=0.02)
    t = np.linspace(0, 4, 4001)
    q, v = 0.05 * np.sin(3 * t), 0.15 * np.cos(3 * t)
    torque, one = np.zeros(1), np.ones(1)
    found = []
    for k in range(len(t)):
        state = JointState(t[k] * one, q[k] * one, v[k] * one, one, one, one)
        torque = law.resist(state, torque, 0.001)
        found.append(torque[0])
    robot = random_arm(3)
    motion = motion_of(robot, len(t))
    motion = replace(motion, q=q[:, None] + 0 * motion.q, v=v[:, None] + 0 * motion.v)
    path = 5.0 * law.columns(motion, None)[:, 0, 0]
    # In the plant it starts unloaded, in a fit a tenth of a second before.
    np.testing.assert_allclose(found[1200:], path[1200:], atol=0.03)
    memory = law.begin([JointState(0.0, 1.0, 2.0, 0.0, 1.0, 0.0)])
    assert memory == (0.8, 0.0)


@settings(max_examples=30)
@given(seed=st.integers(0, 10_000))
def test_presliding_from_instant_to_instant_is_that_of_the_whole_path(seed):
    rng = np.random.default_rng(seed)
    law = effect("presliding", level=5.0, distance=0.02)
    motion = motion_of(random_arm(3), 60)
    q = 0.01 * rng.normal(size=motion.q.shape).cumsum(axis=0)
    motion = replace(motion, q=q, v=rng.normal(size=q.shape))
    found, memory = [], None
    for x, v in zip(q[:, 0], motion.v[:, 0], strict=True):
        state = JointState(0.0, x, v, 0.0, np.sign(v), 0.0)
        memory = law.begin([state]) if memory is None else memory
        (torque,), memory = law.at_instant([state], memory, 0.01)
        found.append(torque)
    whole = 5.0 * law.columns(motion, None)[:, 0, 0]
    np.testing.assert_allclose(found, whole, rtol=1e-9, atol=1e-12)
    assert np.abs(whole).max() <= 5.0


def test_presliding_builds_up_over_its_distance_after_a_reversal():
    law = effect("presliding", level=1.0, distance=0.1)
    motion = motion_of(random_arm(3), 801)
    way = np.concatenate([np.linspace(0, 1, 401), np.linspace(1, 0, 401)[1:]])
    motion = replace(motion, q=way[:, None] + 0 * motion.q, v=0 * motion.v)
    h = law.columns(motion, None)[:, 0, 0]
    up, down = way[:401], 1.0 - way[401:]
    np.testing.assert_allclose(h[:401], 1 - np.exp(-up / 0.1), atol=1e-9)
    np.testing.assert_allclose(
        h[401:], -1 + (1 + h[400]) * np.exp(-down / 0.1), atol=1e-9
    )


# --- encoders, bodies, contact --------------------------------------------------------


def test_an_offset_is_taken_off_its_joint_and_shown_by_its_encoder():
    robot = random_arm(3)
    motion = motion_of(robot)
    law = effect("encoder_offset", 1, offset=0.1)
    true = law.observe(motion, None)
    np.testing.assert_allclose(motion.q[:, 1] - true.q[:, 1], 0.1)
    others = [j for j in range(robot.size) if j != 1]
    np.testing.assert_array_equal(true.q[:, others], motion.q[:, others])
    assert law.true_state(0.5, 2.0, 3.0) == (0.4, 2.0, 3.0)
    assert law.sense(0.4, 2.0) == (0.5, 2.0)


@pytest.mark.parametrize("name", ["encoder_offset", "encoder_eccentricity"])
def test_columns_of_an_encoder_are_the_slope_of_the_torque_by_its_error(name):
    robot = random_arm(7)
    motion = motion_of(robot)
    step, cls = 1e-6, effect_class(name)
    found = cls((1,)).columns(motion, rigid(robot, motion))
    assert found.shape == (*motion.q.shape, len(cls.gains))
    for k, gain in enumerate(cls.gains):
        loads = []
        for sign in (-1, 1):
            law = cls((1,), {gain.name: sign * step})
            loads.append(rigid(robot, law.observe(motion, None)).load)
        slope = (loads[1] - loads[0]) / (2 * step)
        scale = np.abs(slope).max()
        np.testing.assert_allclose(found[:, :, k], slope, atol=1e-6 * scale)


def test_an_eccentric_encoder_shows_its_error_and_takes_it_back_to_the_last_digit():
    law = effect("encoder_eccentricity", sine=0.05, cosine=-0.05)
    q = np.linspace(-4, 4, 33)
    shown, speed = law.sense(q, np.full(33, 2.0))
    np.testing.assert_allclose(shown - q, 0.05 * (np.sin(q) - np.cos(q)))
    np.testing.assert_allclose(speed, 2.0 * (1 + 0.05 * (np.cos(q) + np.sin(q))))
    true, back, _ = law.true_state(shown, speed, 0.0 * q)
    np.testing.assert_allclose(true, q, rtol=0, atol=1e-10)
    np.testing.assert_allclose(back, 2.0, rtol=1e-9)


def test_a_push_lasts_from_its_start_for_its_duration_in_its_recording():
    values = {"force_x": 2.0, "moment_z": -3.0, "start": 1.0, "duration": 0.5}
    t, there = np.array([0.999, 1.0, 1.499, 1.5]), np.array([0, 1, 1, 0])
    for recording, number in ((-1, 7), (2, 2), (2, 0)):
        law = effect("contact", 0, **values, recording=recording)
        push = np.outer(there * (recording in (-1, number)), [2, 0, 0, 0, 0, -3])
        np.testing.assert_array_equal(law.push(t, np.full(4, number)), push)
    robot = random_arm(3)
    motion = replace(motion_of(robot, 300), number=2)
    joints = range(robot.size)
    touching = (motion.t >= 1.0) & (motion.t < 1.5)
    for recording, there in ((-1, True), (2, True), (0, False)):
        law = effect("contact", *joints, **values, recording=recording)
        columns = law.columns(motion, rigid(robot, motion))
        seen = np.abs(columns).max(axis=(1, 2)) > 0
        np.testing.assert_array_equal(seen, touching & there)


@pytest.mark.parametrize("rise", [0.0, 0.3, 1.0])
def test_a_push_rises_and_falls_in_a_part_of_its_duration(rise):
    law = effect("contact", 0, force_x=4.0, start=1.0, duration=0.5, rise=rise)
    t = 1.0 + 0.5 * (np.arange(1000) + 0.5) / 1000
    push = law.push(t, np.zeros(1000, dtype=np.intp))[:, 0]
    assert push.mean() == pytest.approx(4.0 * (1 - rise / 2), rel=1e-4)
    assert push[500] == pytest.approx(4.0, rel=2e-3)
    np.testing.assert_allclose(push, push[::-1], atol=1e-9)  # as fast down as up
    held = push[int(500 * rise) + 1 : 999 - int(500 * rise)]
    np.testing.assert_allclose(held, 4.0, rtol=2e-3)


def test_without_gravity_an_arm_tilts_as_if_it_stood_on_the_floor():
    np.testing.assert_array_equal(level_axes(np.zeros(3)), np.eye(3)[:2])


def test_a_counterbalance_is_reported_within_half_a_turn_of_zero():
    near = effect("counterbalance", dead_centre=3.0)
    assert near.as_reported() is near
    far = effect("counterbalance", dead_centre=3.5).as_reported()
    assert far.values["dead_centre"] == pytest.approx(3.5 - 2 * np.pi)


def test_a_payload_is_a_body_at_the_last_link_with_its_inertia_about_its_centre():
    robot = Robot.load(MODELS / "planar.xml")
    values = {"mass": 2.0, "mx": 0.6, "mz": 0.2, "Ixx": 0.1, "Iyy": 0.4, "Izz": 0.35}
    law = effect("payload", 0, 1, **values, Ixz=-0.02)
    spec = robot.mujoco_spec()
    law.edit_spec(spec, robot.joints)
    mj = spec.compile()
    body = mj.nbody - 1
    assert mj.body_mass[body] == 2.0
    np.testing.assert_allclose(mj.body_ipos[body], [0.3, 0.0, 0.1])
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, mj.body_iquat[body])
    R = R.reshape(3, 3)
    about = R @ np.diag(mj.body_inertia[body]) @ R.T
    steiner = 2.0 * np.array([[0.01, 0, -0.03], [0, 0.1, 0], [-0.03, 0, 0.09]])
    full = np.array([[0.1, 0, -0.02], [0, 0.4, 0], [-0.02, 0, 0.35]])
    np.testing.assert_allclose(about, full - steiner, atol=1e-9)
    for bad, message in (
        ({"mass": 0.0}, "mass is 0 kg"),
        ({"Iyy": 0.1}, "no body of 2 kg has these moments .* valid are mx to Izz"),
        ({"Iyy": 0.8}, "no body of 2 kg has these moments .* valid are mx to Izz"),
    ):
        with pytest.raises(EffectError, match=message):
            effect("payload", 0, 1, **{**values, **bad}).edit_spec(
                robot.mujoco_spec(), robot.joints
            )


def test_a_changed_link_is_that_of_its_outermost_joint_and_loads_all_below():
    law = effect("link_inertia", 1, mass=1.0, Izz=2.0)
    assert law.joints == (0, 1)
    change, gravity = law.rigid_change(4, np.array([0, 0, -9.81]))
    assert change[1].tolist() == [1.0, *[0.0] * 8, 2.0]
    assert not np.delete(change, 1, axis=0).any() and not gravity.any()


def test_a_coupled_rotor_turns_with_the_sum_of_its_joints():
    law = effect("transmission_coupling", 0, 2, inertia=0.5, viscous=2.0, coulomb=3.0)
    robot = random_arm(7)
    motion = motion_of(robot)
    v, a = (x[:, 0] + x[:, 2] for x in (motion.v, motion.a))
    expected = 0.5 * a + 2.0 * v + 3.0 * np.sign(v)
    torque = law.columns(motion, None) @ law.gain_values
    np.testing.assert_allclose(torque, np.stack([expected] * 2, axis=1))
    k, signals = 4, (motion.q, motion.v, motion.a)
    states = [JointState(0, *(x[k, j] for x in signals), 0, 0) for j in (0, 2)]
    now, memory = law.at_instant(states, (), 0.001)
    assert now == pytest.approx([expected[k]] * 2) and memory == ()


# --- soft and loose gears -------------------------------------------------------------


def test_a_swing_solves_its_equation_from_rest_under_the_first_load():
    h = 0.001
    t = np.arange(0, 2, h)
    m, c, k, step_load = 0.5, 1.0, 200.0, 10.0
    load = np.where(t < 0.2, 0.0, -step_load)
    d = _swing(np.stack([np.full_like(t, x) for x in (m, c, k)] + [load]), h)
    since, w = t - 0.2, np.sqrt(k / m - (c / (2 * m)) ** 2)
    decay = np.exp(-c / (2 * m) * since)
    exact = (
        step_load
        / k
        * (1 - decay * (np.cos(w * since) + c / (2 * m * w) * np.sin(w * since)))
    )
    np.testing.assert_allclose(d[t < 0.19], 0.0, atol=1e-12)
    np.testing.assert_allclose(d[t > 0.21], exact[t > 0.21], atol=0.01 * step_load / k)
    still = _swing(np.stack([np.full(50, x) for x in (m, c, k, 8.0)]), h)
    np.testing.assert_allclose(still, -8.0 / k, rtol=1e-9)


def test_a_soft_joint_has_the_frequency_of_its_link_on_its_spring():
    robot = Robot.load(MODELS / "planar.xml")
    motion = motion_of(robot, 400)
    body = rigid(robot, motion)
    law = effect("elasticity", 1, compliance=0.002)
    push = np.ones(len(motion.t))
    inertia = body.response(1, 0 * push, 0 * push, push)[:, 1].mean()
    expected = np.sqrt(1.0 / (0.002 * inertia)) / (2 * np.pi)
    assert law.frequency(body) == pytest.approx(expected)
    assert effect("elasticity", 1).frequency(body) == np.inf


def test_a_soft_link_rings_at_its_frequency_after_its_motor_has_stopped():
    robot = Robot.load(MODELS / "planar.xml")
    chain = replace(robot.chain, gravity=np.zeros(3))
    t = np.arange(0, 6, 0.001)
    phase = np.clip((t - 1.0) / 0.2, 0, 1)
    elbow = 0.3 * phase**3 * (10 - 15 * phase + 6 * phase**2)
    q = np.stack([0 * t, elbow], axis=1)
    v = np.gradient(q, t, axis=0)
    motion = Motion(t, q, v, np.gradient(v, t, axis=0), 0 * q, np.ones(len(t), bool))
    body = RigidBody(chain, motion)
    law = effect("elasticity", 1, compliance=0.02, damping=0.0)
    swing = (law.observe(motion, body).q - q)[t > 1.5, 1]
    crossings = np.flatnonzero(np.diff(np.sign(swing)))
    found = (len(crossings) - 1) / (2 * 0.001 * (crossings[-1] - crossings[0]))
    assert found == pytest.approx(law.frequency(body), rel=0.02)
    # No gear rings for longer than a twentieth of the critical damping lets it.
    tops = np.abs(swing[crossings[:-1] + np.diff(crossings) // 2])
    decay = np.log(tops[1:6] / tops[:5]).mean() / np.pi
    assert -0.075 < decay < -0.045


def test_a_stiff_spring_gives_way_by_load_over_stiffness():
    robot = Robot.load(MODELS / "planar.xml")
    t = np.arange(0, 4, 0.001)
    q = np.stack([0.3 * np.sin(t), 0.2 * np.cos(1.3 * t)], axis=1)
    v = np.gradient(q, t, axis=0)
    motion = Motion(t, q, v, np.gradient(v, t, axis=0), 0 * q, np.ones(len(t), bool))
    body = rigid(robot, motion)
    law = effect("elasticity", 1, compliance=1e-4, damping=2.0)
    twist = (law.observe(motion, body).q - q)[200:-200]
    np.testing.assert_array_equal(twist[:, 0], 0.0)
    np.testing.assert_allclose(
        twist[:, 1], -1e-4 * body.load[200:-200, 1], atol=0.03 * np.ptp(twist[:, 1])
    )
    assert effect("elasticity", 1).observe(motion, body) is motion


def test_a_link_falls_across_its_play_by_its_pull():
    step, half = 0.001, 0.01
    pull = np.where(np.arange(400) < 100, 1.0, -2.0)
    where = _link_position(pull, half, step)
    np.testing.assert_array_equal(where[:100], -half)
    since = step * (np.arange(400) - 99)
    flight = (np.arange(400) >= 100) & (since**2 < 0.9 * 2 * half)
    np.testing.assert_allclose(
        where[flight], (since**2 - half)[flight], atol=3 * step * 2 * np.sqrt(2 * half)
    )
    np.testing.assert_array_equal(where[-150:], half)
    back = _link_position(-pull, half, step)
    np.testing.assert_allclose(back, -where, atol=1e-15)


def test_a_flight_that_turns_back_lands_where_it_started():
    step = 0.01
    there_and_back = np.concatenate([np.full(10, 1.0), np.full(100, -1.0)])
    path, landed = _flight(there_and_back, 1.0, step)
    assert not landed and 20 < len(path) < 60 and (path >= 0).all()
    path, landed = _flight(np.full(300, 1.0), 0.01, step)
    assert landed and path[-1] < 0.02 <= path[-1] + 0.01
    path, landed = _flight(np.full(3, 1e-9), 1.0, step)
    assert not landed and len(path) == 3


def test_a_link_behind_play_lags_by_half_of_it_and_without_play_by_nothing():
    robot = Robot.load(MODELS / "planar.xml")
    motion = motion_of(robot, 400)
    t = motion.t
    q = np.stack([0.5 * np.sin(t), 0.4 * np.sin(1.7 * t)], axis=1)
    v, a = (
        np.gradient(q, t, axis=0),
        np.gradient(np.gradient(q, t, axis=0), t, axis=0),
    )
    motion = replace(motion, q=q, v=v, a=a)
    body = rigid(robot, motion)
    assert effect("backlash", 1).observe(motion, body) is motion
    lag = (effect("backlash", 1, half_width=0.003).observe(motion, body).q - q)[:, 1]
    assert np.abs(lag).max() == pytest.approx(0.003)
    pressed = np.abs(body.load[:, 1]) > 0.5 * np.abs(body.load[:, 1]).max()
    at_stop = -0.003 * np.sign(body.load[:, 1])
    assert np.mean(np.isclose(lag, at_stop)[pressed]) > 0.9


@pytest.mark.parametrize("name", ["backlash", "elasticity"])
def test_a_gear_has_a_second_joint_behind_the_motors_and_needs_a_rotor(name):
    robot = Robot.load(MODELS / "planar.xml")
    gain = {"backlash": "half_width", "elasticity": "compliance"}[name]
    law, spec = effect(name, 1, **{gain: 0.004}), robot.mujoco_spec()
    spec.joint("elbow").armature = 0.0
    with pytest.raises(EffectError, match="needs a rotor"):
        law.edit_spec(spec, robot.joints)
    spec.joint("elbow").armature = 0.2
    law.edit_spec(spec, robot.joints)
    mj = spec.compile()
    second = mj.joint(f"elbow/{law.behind}")
    if name == "backlash":
        np.testing.assert_allclose(second.range, [-0.004, 0.004])
        assert mj.jnt_limited[second.id] == 1
        assert mj.dof_armature[second.dofadr[0]] == pytest.approx(0.002)
    else:
        stiffness = np.ravel(mj.jnt_stiffness[second.id])[0]
        assert stiffness == pytest.approx(250.0)
        damping = np.ravel(mj.dof_damping[second.dofadr[0]])[0]
        assert damping == pytest.approx(law.values["damping"])
    untouched = robot.mujoco_spec()
    effect(name, 1).edit_spec(untouched, robot.joints)
    assert untouched.compile().njnt == 2


# --- what effects say of themselves ---------------------------------------------------


def test_flags_tell_a_fit_how_to_treat_an_effect():
    def flagged(flag):
        classes = ("elasticity", "backlash", "delay", "actuator_lag", "coulomb")
        return {name for name in classes if getattr(effect_class(name), flag)}

    dry = {name for name, cls in effect_classes().items() if getattr(cls, "dry", False)}
    assert dry >= {
        "coulomb", "stribeck", "asymmetric_friction",
        "load_friction", "threshold_friction",
    }  # fmt: skip
    assert not dry & {"viscous", "nonlinear_viscous", "thermal_friction", "spring"}
    assert flagged("steep") == {"elasticity", "backlash"}
    assert flagged("shows_in_motion") == {
        "elasticity",
        "backlash",
        "delay",
        "actuator_lag",
    }
    assert flagged("differentiates") == {"delay", "actuator_lag"}
    assert flagged("shifts") == {"delay"}
    assert flagged("not_in_loop") == {"elasticity", "backlash", "delay"}
    inexact = {
        n: dict(effect_class(n).inexact) for n in ("elasticity", "controller_gain")
    }
    assert inexact == {
        "elasticity": {"compliance": 0.05, "damping": 0.5},
        "controller_gain": {"damping": 0.03, "stiffness": 0.001},
    }


def test_an_effect_of_a_joint_has_one_and_others_have_some():
    with pytest.raises(EffectError, match="coulomb acts on one joint, not 2"):
        effect_class("coulomb")((0, 1))
    with pytest.raises(EffectError, match="coupling acts on at least one joint, not 0"):
        effect_class("transmission_coupling")(())


def test_an_effect_of_several_joints_has_the_size_of_the_last():
    cls = effect_class("transmission_coupling")
    sizes = [Scale(10.0, 2.0), Scale(4.0, 8.0), Scale(70.0, 1.0)]
    law = cls.typical((0, 1), sizes)
    assert law.values == pytest.approx(
        {"inertia": 0.005, "viscous": 0.01, "coulomb": 0.08}
    )


@pytest.mark.parametrize(("name", "gain"), [("backlash", 0.004), ("elasticity", 0.003)])
def test_columns_of_a_gear_are_the_torque_of_its_links_motion_over_its_gain(name, gain):
    robot = Robot.load(MODELS / "planar.xml")
    t = np.arange(0, 4, 0.01)
    q = np.stack([0.5 * np.sin(t), 0.4 * np.sin(1.7 * t)], axis=1)
    v = np.stack([0.5 * np.cos(t), 0.68 * np.cos(1.7 * t)], axis=1)
    motion = Motion(t, q, v, -q * [1.0, 2.89], 0 * q, np.ones(len(t), bool))
    body = rigid(robot, motion)
    law = effect(name, 1)
    (only,) = law.gains
    law = law.at({only.name: gain})
    moved = law.observe(motion, body)
    changes = moved.q - q, moved.v - v, moved.a - motion.a
    torque = body.response(1, *(x[:, 1] for x in changes))
    assert np.abs(torque).max() > 0
    np.testing.assert_allclose(
        law.columns(motion, body)[:, :, 0] * gain,
        torque,
        atol=1e-9 * np.abs(torque).max(),
    )
