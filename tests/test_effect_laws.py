"""The laws that are more than one line obey physics."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.dynamics import RigidBody
from hybrid.effects import JointState, effect_class
from hybrid.effects.gravity_tilt import level_axes
from hybrid.effects.presliding import dahl
from hybrid.plant.lockstep import lagged
from hybrid.robot import Robot
from hybrid.signals import Motion


def effect(name, *joints, **values):
    return effect_class(name)(joints or (0,), values)


def motion_of(robot, samples=20, seed=0):
    q, v, a = random_states(robot.size, samples, seed)
    t = 0.01 * np.arange(samples)
    return Motion(t, q, v, a, 0 * q, np.ones(samples, dtype=bool))


# --- presliding ---------------------------------------------------------------------


def one_by_one(q, speed, distance):
    h, states = 0.0, []
    before = q[0] - 0.1 * speed
    for x in q:
        s = np.sign(x - before)
        h = s + (h - s) * np.exp(-abs(x - before) / distance)
        before = x
        states.append(h)
    return np.array(states)


@given(
    seed=st.integers(0, 1000),
    samples=st.integers(1, 300),
    distance=st.floats(1e-4, 1.0),
    speed=st.floats(-2, 2),
)
def test_all_of_a_path_at_once_is_the_same_as_sample_by_sample(
    seed, samples, distance, speed
):
    q = 0.01 * np.random.default_rng(seed).normal(size=samples).cumsum()
    h = dahl(q, speed, distance)
    np.testing.assert_allclose(h, one_by_one(q, speed, distance), atol=1e-12)
    assert (np.abs(h) <= 1.0 + 1e-12).all()


def test_presliding_friction_solves_its_differential_equation():
    t = np.linspace(0, 4, 40001)
    q, v = 0.05 * np.sin(3 * t), 0.15 * np.cos(3 * t)
    h = dahl(q, v[0], 0.02)
    slope = np.gradient(h, t)
    expected = (v - np.abs(v) * h) / 0.02
    away = np.abs(v) > 0.002  # dh/dt has a kink at each reversal
    np.testing.assert_allclose(slope[away], expected[away], atol=2e-3)


def test_presliding_friction_depends_on_the_path_and_not_on_its_speed():
    path = np.concatenate([np.linspace(0, 0.1, 500), np.linspace(0.1, 0.07, 300)])
    rng = np.random.default_rng(0)
    often = np.sort(np.concatenate([np.arange(800.0), rng.uniform(0, 799, 3000)]))
    fine = dahl(np.interp(often, np.arange(800), path), 0.0, 0.02)
    coarse = dahl(path, 0.0, 0.02)
    np.testing.assert_allclose(fine[np.searchsorted(often, np.arange(800.0))], coarse,
                               atol=1e-9)  # fmt: skip


@given(size=st.floats(1e-3, 1.0), distance=st.floats(1e-3, 0.2))
def test_a_closed_path_costs_energy(size, distance):
    q = size * np.sin(np.linspace(0, 6 * np.pi, 3001))
    h = dahl(q, 0.0, distance)
    loop = slice(1000, 3001)
    work = np.trapezoid(h[loop], q[loop])
    assert 0 < work <= 2 * 4 * size  # at most that of Coulomb friction, twice round


def test_presliding_friction_is_a_spring_first_and_coulomb_friction_far_on():
    q = np.linspace(0, 1.0, 10001)
    h = dahl(q, 0.0, 0.02)
    assert (h[1] - h[0]) / (q[1] - q[0]) == pytest.approx(1 / 0.02, rel=0.01)
    assert h[-1] == pytest.approx(1.0)


# --- thermal friction ---------------------------------------------------------------

ENDLESS = 1e3  # rad²/s: no loss of these motions heats that much


def weight(motion, **values):
    """Weight of the cold friction of the first joint along a motion, shape (N,)."""
    law = effect("thermal_friction", cold=1.0, **values)
    columns = law.columns(motion, RigidBody(random_arm(1).chain, motion))
    return columns[:, 0, 0] / motion.v[:, 0]


def turning(speed, samples=3000, step=0.01):
    """A joint that turns with a speed of the clock, [rad/s]."""
    t = step * np.arange(samples)
    v = speed(t)[:, None]
    return Motion(t, v, v, v, 0 * v, np.ones(samples, dtype=bool))


def test_without_loss_cold_friction_fades_with_the_clock():
    motion = turning(lambda t: 1e-3 + 0 * t)
    left = weight(motion, time_constant=20.0, warm_up=ENDLESS)
    np.testing.assert_allclose(left, np.exp(-motion.t / 20.0), rtol=1e-6)


@pytest.mark.parametrize("time_constant", [8.0, 1e4])
def test_cold_friction_solves_its_heat_balance(time_constant):
    motion = turning(lambda t: 0.4 + 1.3 * np.sin(1.7 * t) ** 2, 20001, 0.001)
    left = weight(motion, time_constant=time_constant, warm_up=5.0)
    h = -np.log(left)
    heat = 1.0 / time_constant + left * motion.v[:, 0] ** 2 / 5.0
    np.testing.assert_allclose(np.gradient(h, motion.t)[5:-5], heat[5:-5], rtol=1e-2)


def test_an_arm_at_rest_stays_cold_however_long_the_log_lasts():
    still = turning(lambda t: np.where(t < 20.0, 1e-6, 1.0))
    left = weight(still, time_constant=1e4, warm_up=2.0)
    assert left[1999] > 0.99 > 0.3 > left[-1]
    assert (np.diff(left) <= 0.0).all()


def test_cold_friction_follows_a_measured_temperature_instead():
    motion = motion_of(random_arm(1))
    for kelvin, rest in ((0.0, 1.0), (20.0, 1 / np.e)):
        warm = replace(motion, temperature=np.full((20, 1), 20.0 + kelvin))
        np.testing.assert_allclose(weight(warm, warm_up=0.1), rest)
    law = effect("thermal_friction")
    assert [x.name for x in law.shapes_along([warm])] == ["temperature_scale"]
    (scale,) = set(law.shapes) - {*law.shapes_along([motion])}
    assert scale.name == "temperature_scale"


# --- friction with a memory ---------------------------------------------------------


@pytest.mark.parametrize("name", ["thermal_friction", "friction_lag"])
@given(seed=st.integers(0, 1000), share=st.floats(0.01, 0.99))
def test_a_motion_at_once_is_one_sample_after_the_other(name, seed, share):
    motion = motion_of(random_arm(1), 50, seed)
    law = effect(name)
    ends = ((x.name, (x.lower, x.upper)) for x in law.shapes_along([motion]))
    shapes = {x: low * (high / low) ** share for x, (low, high) in ends}
    law = law.at({law.gains[0].name: 2.0, **shapes})
    memory, told, again = None, [], []
    past = zip(*law.remembered(motion), strict=True)
    states = motion.t, motion.q[:, 0], motion.v[:, 0], motion.a[:, 0]
    for t, q, v, a, known in zip(*states, past, strict=True):
        state = JointState(t, q, v, a, np.sign(v), 0.0)
        memory = law.begin([state]) if memory is None else memory
        torque, memory = law.at_instant([state], memory, 0.01)
        told.append(torque[0])
        again.append(law.at_instant([state], known, 0.0)[0][0])
    columns = law.columns(motion, RigidBody(random_arm(1).chain, motion))
    for torques in (told, again):
        np.testing.assert_allclose(torques, 2 * columns[:, 0, 0], rtol=1e-9, atol=1e-12)


@given(turns=st.floats(0.1, 3.0), time=st.floats(0.006, 0.49))
def test_lagging_friction_follows_a_sine_less_and_later(turns, time):
    w = 2 * np.pi * turns
    motion = turning(lambda t: np.sin(w * t), 4000, 0.002)
    (u,) = effect("friction_lag", time=time).columns(motion, None).T[0]
    expected = np.sin(w * motion.t - np.arctan(w * time)) / np.hypot(1.0, w * time)
    late = motion.t > 10 * time
    np.testing.assert_allclose(u[late], expected[late], atol=0.01)


@given(seed=st.integers(0, 1000), time=st.floats(0.006, 0.49))
def test_lagging_friction_takes_energy_from_every_motion_that_began_at_rest(seed, time):
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=400).cumsum() * np.minimum(np.arange(400) / 40, 1.0)
    motion = turning(lambda t: steps, 400, 0.005)
    (u,) = effect("friction_lag", time=time).columns(motion, None).T[0]
    assert np.cumsum(u * motion.v[:, 0]).min() >= -1e-9


# --- counterbalance -----------------------------------------------------------------


@given(q=st.floats(-7, 7), phi=st.floats(-3, 3), ratio=st.floats(0.02, 0.9))
def test_a_counterbalance_is_the_slope_of_its_spring_energy(q, phi, ratio):
    base, stiffness, rest, preload = 0.8, 3000.0, 0.7, 500.0  # m, N/m, m, N
    crank = ratio * base

    def energy(x):
        squared = base**2 + crank**2 - 2 * base * crank * np.cos(x - phi)
        stretch = np.sqrt(squared) - rest
        return 0.5 * stiffness * stretch**2 + preload * stretch

    law = effect(
        "counterbalance",
        spring=stiffness * base * crank,
        preload=(preload - stiffness * rest) * crank,
        dead_centre=phi,
        crank_ratio=ratio,
    )
    x = np.full(1, q)
    parts = law.law(JointState(x, x, x, x, x, x), **law.shape_values)
    torque = sum(g * part[0] for g, part in zip(law.gain_values, parts, strict=True))
    slope = (energy(q + 1e-5) - energy(q - 1e-5)) / 2e-5
    assert torque == pytest.approx(slope, rel=1e-5, abs=1e-3)


# --- gravity, contact and encoders along a whole arm --------------------------------


@given(
    gravity=st.tuples(*[st.floats(-10, 10)] * 3).filter(
        lambda g: np.linalg.norm(g) > 0.1
    )
)
def test_the_axes_of_a_tilt_are_level_and_square(gravity):
    axes = level_axes(np.array(gravity))
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(axes @ gravity, 0, atol=1e-12 * 20)


def test_an_arm_on_the_floor_tilts_about_x_and_y():
    np.testing.assert_array_equal(level_axes(np.array([0, 0, -9.81])), np.eye(3)[:2])


def test_a_tilted_turntable_feels_its_weight():
    # Turned about +x by α, the base sees gravity along −y; a weight at x turns about z.
    robot = Robot.load(MODELS / "scara.xml")
    motion = motion_of(robot)
    body = RigidBody(robot.chain, motion)
    columns = effect("gravity_tilt", *range(robot.size)).columns(motion, body)
    angle = 1e-4
    tilted = replace(
        robot.chain,
        gravity=9.81 * np.array([0.0, -np.sin(angle), -np.cos(angle)]),
    )
    changed = RigidBody(tilted, motion).load - body.load
    np.testing.assert_allclose(columns[:, :, 0], changed / angle, atol=1e-2)


@settings(max_examples=20)
@given(seed=st.integers(0, 500))
def test_a_push_is_balanced_by_the_torque_of_its_columns(seed):
    """Virtual work: columns · joint speed = force · velocity + moment · turning."""
    robot = random_arm(seed)
    motion = motion_of(robot, 5, seed)
    last = robot.size - 1
    columns = RigidBody(robot.chain, motion).wrench_columns(last)
    step = 1e-6 * motion.v
    for k in range(5):
        (before, after) = (poses(robot, motion.q[k] + s * step[k]) for s in (-1, 1))
        speed = (after[1] - before[1]) / 2e-6
        spin = (after[0] @ before[0].T - before[0] @ after[0].T) / 4e-6
        turning = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        np.testing.assert_allclose(
            motion.v[k] @ columns[k], np.concatenate([speed, turning]), atol=1e-5
        )


def poses(robot, q):
    """Rotation and origin of the last link in the base frame."""
    from scipy.spatial.transform import Rotation

    chain, R, p = robot.chain, np.eye(3), np.zeros(3)
    for k in range(chain.size):
        p = p + R @ chain.translation[k]
        R = R @ chain.rotation[k]
        if chain.revolute[k]:
            R = R @ Rotation.from_rotvec(chain.axis[k] * q[k]).as_matrix()
        else:
            p = p + R @ chain.axis[k] * q[k]
    return R, p


@given(sine=st.floats(-0.05, 0.05), cosine=st.floats(-0.05, 0.05))
def test_an_eccentric_encoder_is_undone_exactly(sine, cosine):
    law = effect("encoder_eccentricity", sine=sine, cosine=cosine)
    t = np.linspace(0, 1, 2001)
    q, v, a = np.sin(3 * t), 3 * np.cos(3 * t), -9 * np.sin(3 * t)
    shown, speed = law.sense(q, v)
    acceleration = np.gradient(speed, t)
    n = len(t)
    measured = Motion(
        t, *(x[:, None] for x in (shown, speed, acceleration, 0 * t)), np.ones(n, bool)
    )
    true = law.observe(measured, None)
    np.testing.assert_allclose(true.q[:, 0], q, atol=1e-9)
    np.testing.assert_allclose(true.v[:, 0], v, atol=1e-8)
    np.testing.assert_allclose(true.a[1:-1, 0], a[1:-1], atol=1e-4)


# --- drives -------------------------------------------------------------------------


@given(x=st.floats(-100, 100), part=st.floats(0, 1))
def test_a_drive_loses_torque_beyond_its_limit_or_within_its_dead_zone(x, part):
    torque = np.full(1, x)
    (clipped,) = effect("saturation", loss=1.0, limit=40.0).deliver(torque)
    assert clipped == np.clip(x, -40, 40)
    (through,) = effect("deadzone", width=2.0).deliver(torque)
    assert through == np.sign(x) * max(abs(x) - 2.0, 0.0)
    (less,) = effect("saturation", loss=part).deliver(torque)
    assert less * x >= 0 and abs(less) <= abs(x)


def test_without_a_measured_torque_no_drive_is_taken_to_lose_any():
    robot = random_arm(3)
    motion = motion_of(robot)
    motion = replace(motion, tau=np.full_like(motion.q, np.nan))
    body = RigidBody(robot.chain, motion)
    for lost in (effect("saturation", 1, loss=1.0), effect("deadzone", 1, width=1.0)):
        assert not lost.torque(motion, body).any()


@pytest.mark.parametrize("declared", [True, False])
def test_a_drive_that_clips_delivers_its_limit_whatever_friction_is_declared(declared):
    robot = random_arm(3)
    motion = motion_of(robot, samples=1000)
    asked = 40.0 * np.sin(2.0 * motion.t + 1.0)[:, None] + 0.0 * motion.q
    friction = 6.0 * np.sign(motion.v) + 4.0 * motion.v
    given = np.clip(asked, -20.0, 20.0) - (0.0 if declared else friction)
    motion = replace(motion, tau=given, asked=asked)
    at = {limit: effect("saturation", limit=limit, total=1.0) for limit in (20.0, 10.0)}
    assert at[20.0].holds([motion]) and not at[10.0].holds([motion])
    beyond = asked[:, :1] - np.clip(asked[:, :1], -20.0, 20.0)
    body = RigidBody(robot.chain, motion)
    np.testing.assert_array_equal(at[20.0].columns(motion, body)[:, :, 0], beyond)


@pytest.mark.parametrize("time", [0.02, -0.02])
def test_a_lag_has_the_phase_and_size_of_first_order(time):
    t, omega = np.linspace(0, 6, 12001), 2 * np.pi * 4
    lag = effect("actuator_lag", time=time)
    out = lag.report(t, np.sin(omega * t)[:, None])[2000:-100, 0]
    basis = np.stack([np.sin(omega * t), np.cos(omega * t)], axis=1)[2000:-100]
    (s, c), *_ = np.linalg.lstsq(basis, out)
    expected = 1 + 1j * omega * time if time > 0 else 1 / (1 - 1j * omega * time)
    assert s + 1j * c == pytest.approx(expected, abs=2e-3)


@given(time=st.floats(-0.05, 0.05), seed=st.integers(0, 100))
def test_what_a_lag_reports_is_a_linear_map_that_keeps_constants(time, seed):
    t, lag = np.linspace(0, 1, 200), effect("actuator_lag", time=time)
    x, y = np.random.default_rng(seed).normal(size=(2, 200, 2))
    both = lag.report(t, 2 * x - 5 * y)
    parts = 2 * lag.report(t, x) - 5 * lag.report(t, y)
    np.testing.assert_allclose(both, parts, atol=1e-9)
    np.testing.assert_allclose(lag.report(t, np.full((200, 1), 3.0)), 3.0, atol=1e-12)


@pytest.mark.parametrize("step", [0.001, 0.0002])
def test_a_drive_follows_what_it_reports_with_its_lag(step):
    t = np.arange(0, 3, step)
    torque, lag = np.sin(5 * t), effect("actuator_lag", time=0.02)
    delivered, before = [], np.zeros(1)
    for x in torque:
        before = lagged(np.full(1, x), before, lag.actuator["lag"], step)
        delivered.append(before[0])
    ahead = lag.report(t, np.array(delivered)[:, None])[:, 0]
    late = t > 0.5
    np.testing.assert_allclose(ahead[late], torque[late], atol=3 * step)
