"""Online identification: it tracks, notices payloads, and rest does no harm."""

from functools import cache

import numpy as np
import pytest
from arms import MODELS, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st

from hybrid.dynamics import RigidBody, inverse_dynamics, regressor, regressor_law
from hybrid.effects import effects_from_text
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.stribeck import Stribeck
from hybrid.effects.thermal_friction import ThermalFriction
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.errors import IdentificationError, RecordingError
from hybrid.identification import DynamicModel
from hybrid.online import OnlineIdentifier, Sample
from hybrid.online.columns import InstantColumns
from hybrid.online.layout import RowLayout
from hybrid.online.square_root import SquareRootFilter
from hybrid.plant import random_fourier
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.signals import Motion, Sampler
from hybrid.signals.streaming import LocalPolynomial

RATE = 250.0


@cache
def arm():
    return Robot.load(MODELS / "coman_like.xml")


@cache
def effects():
    text = "coulomb,viscous,stribeck(exponent=2.0)"
    return effects_from_text(text, arm().joints, joint_scales(arm()))


@cache
def log(seconds=30.0, seed=0, mass=0.0, at=np.inf, noise=0.3):
    """Clock, position, torque and true links of an arm 15 % off its file."""
    rng = np.random.default_rng(seed)
    ref = random_fourier(arm(), duration=seconds, rate=RATE, seed=rng)
    off = np.random.default_rng(0).uniform(0.85, 1.15, (6, 1))
    links = arm().chain.inertial * off
    loaded = links.copy()
    loaded[-1] += mass * np.array([1, 0, 0, 0.1, 0.02, 0, 0.02, 0, 0, 0.005])
    before, after = (
        inverse_dynamics(arm().chain, x, ref.q, ref.v, ref.a) for x in (links, loaded)
    )
    tau = np.where(ref.t[:, None] < at, before, after)
    for effect in effects():
        j, x = effect.joints[0], effect.values
        v = ref.v[:, j]
        tau[:, j] += x.get("coefficient", 0.0) * v
        fall = np.exp(-((v / 0.05) ** 2)) if effect.id == "stribeck" else 1.0
        tau[:, j] += 0.8 * x.get("level", 0.0) * fall * np.sign(v)
    torque = np.array([s.torque for s in joint_scales(arm())])
    tau += noise * 0.01 * torque * rng.standard_normal(tau.shape)
    return ref.t, ref.q + 1e-6 * rng.standard_normal(ref.q.shape), tau, links


def tracked(data, tracker=None, **options):
    t, q, tau, _ = data
    tracker = tracker or OnlineIdentifier(arm(), effects(), rate=RATE, **options)
    for k in range(len(t)):
        tracker.update(Sample(float(t[k]), q[k], tau[k]))
    return tracker


@cache
def after_thirty_seconds():
    return tracked(log())


# --- what it is made of ---------------------------------------------------------------


def test_the_regressor_of_one_sample_is_that_of_many():
    for seed in range(6):
        robot = random_arm(seed)
        states = random_states(robot.size, 20, seed)
        many = regressor(robot.chain, *states)
        one = regressor_law(robot.chain, tuple(range(many[0].size)))
        for k in range(20):
            found = one.at(np.concatenate([x[k] for x in states]).tolist())
            np.testing.assert_allclose(found, many[k].ravel(), rtol=1e-9, atol=1e-9)


def test_too_low_a_rate_is_refused():
    with pytest.raises(RecordingError, match="above 50 Hz"):
        LocalPolynomial(45.0, 10.0)


def update(square, H, error, forgetting=1.0):
    for _ in square.update(H @ square.root, error, forgetting):
        pass


@settings(max_examples=25)
@given(seed=st.integers(0, 999), forgetting=st.floats(0.5, 1), rank=st.integers(0, 3))
def test_the_covariance_never_grows_whatever_is_seen(seed, forgetting, rank):
    rng = np.random.default_rng(seed)
    square = SquareRootFilter(np.zeros(6), rng.normal(size=(6, 6)))
    directions = rng.normal(size=(rank, 6)) * 10.0 ** rng.uniform(-4, 4)
    for _ in range(30):
        before = square.covariance
        H = rng.normal(size=(3, rank)) @ directions
        update(square, H, rng.normal(size=3), forgetting)
        change = np.linalg.eigvalsh(before - square.covariance)
        assert change.min() >= -1e-9 * np.abs(before).max()


def test_with_forgetting_it_follows_what_drifts_and_without_it_does_not():
    rng, ends = np.random.default_rng(1), []
    for forgetting in (1.0, 0.95):
        square = SquareRootFilter(np.zeros(2), np.eye(2))
        for k in range(4000):
            H = rng.normal(size=(1, 2))
            truth = np.array([1.0, 1.0 + k / 1000])
            y = H @ truth + 0.1 * rng.normal(size=1)
            update(square, H / 0.1, (y - H @ square.mean) / 0.1, forgetting)
        ends.append(abs(square.mean[1] - truth[1]))
    assert ends[0] > 0.5 and ends[1] < 0.25


def test_bounds_hold_where_unknowns_depend_on_each_other_or_are_held():
    root = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    for mean in ([-1.0, -2.0, 0.5], [-1.0, 0.5, -3.0]):
        square = SquareRootFilter(np.array(mean), root)
        square.clip(np.zeros(3), np.ones(3))
        assert np.all((square.mean >= 0) & (square.mean <= 1))


@pytest.mark.parametrize("branches", [False, True])
def test_columns_of_an_instant_are_the_slopes_of_the_torque(branches, monkeypatch):
    kinds = "stribeck,load_friction,threshold_friction,torque_offset"
    some = effects_from_text(kinds, arm().joints, joint_scales(arm()))
    some.append(TransmissionCoupling.typical((4, 5), joint_scales(arm())))
    if branches:  # a law that cannot be written down is asked as a whole
        law = Stribeck.law

        def whole_motion(state, **shapes):
            return law(state, **shapes) if np.all(state.v < np.inf) else ()

        monkeypatch.setattr(Stribeck, "law", staticmethod(whole_motion))
    tracker = OnlineIdentifier(arm(), some, rate=RATE)
    problem, theta = tracker.problem, tracker.theta
    layout = RowLayout(problem, tracked=True)
    columns = InstantColumns(arm(), problem, layout, 1)
    q, v, a = (x[:1] for x in random_states(6, 1, 3))
    v *= 0.02

    def derivative(x):
        for _ in columns.fill((np.zeros(1), q, v, a), x):
            pass
        return columns.rows[0, :, : layout.size].copy()

    J = derivative(theta)
    whole = regressor(arm().chain, q, v, a)[0]
    last = columns.rows[0, :, layout.payload]
    np.testing.assert_allclose(last, whole[:, -10:-6], atol=1e-9)
    rigid = whole[:, np.array(problem.base.kept)[problem.rigid]]
    np.testing.assert_allclose(J[:, problem.rigid], rigid, atol=1e-9)
    p = problem.size
    for k in range(p, len(theta)):
        step = 1e-6 * theta[k] * np.eye(len(theta))[k]
        up, down = (derivative(x)[:, :p] @ x[:p] for x in (theta + step, theta - step))
        slope = (up - down) / (2e-6 * theta[k])
        np.testing.assert_allclose(
            J[:, k], slope, atol=2e-3 * np.abs(slope).max() + 1e-6
        )


@pytest.mark.parametrize("kind", ["friction_lag", "presliding"])
def test_columns_remember_the_blocks_before(kind):
    (effect,) = effects_from_text(f"{kind}:2", arm().joints, joint_scales(arm()))
    tracker = OnlineIdentifier(arm(), [effect], rate=RATE)
    problem, theta = tracker.problem, tracker.theta
    columns = InstantColumns(arm(), problem, RowLayout(problem, tracked=True), 5)
    ref = random_fourier(arm(), duration=1.0, rate=100.0, seed=0)
    states, found = (ref.t, ref.q, ref.v, ref.a), []
    ((unknown, _, _),) = problem.gains
    for first in range(0, 100, 5):
        for _ in columns.fill(tuple(x[first : first + 5] for x in states), theta):
            pass
        found.append(columns.rows[:, effect.joints[0], unknown].copy())
    motion = Motion(*states, 0 * ref.q, np.ones(len(ref.t), dtype=bool))
    whole = effect.columns(motion, RigidBody(arm().chain, motion))[:100, 0, 0]
    np.testing.assert_allclose(np.concatenate(found), whole, rtol=1e-9, atol=1e-12)


# --- what it does ---------------------------------------------------------------------


def test_parameters_are_found_within_their_uncertainty():
    tracker, (*_, links) = after_thirty_seconds(), log()
    p = tracker.problem
    rigid = p.rigid
    truth = (p.base.mapping[:, :60] @ links.ravel())[rigid]
    z = (tracker.theta[rigid] - truth) / tracker.std[rigid]
    assert np.sqrt(np.mean(z**2)) < 1.6 and np.abs(z).max() < 4.5
    assert not tracker.changes


def test_nonlinear_friction_is_found_with_the_rest():
    found = {p.name: p for p in after_thirty_seconds().parameters}
    for effect in effects():
        j = effect.joints[0]
        if effect.id == "coulomb":
            level = found[f"coulomb.level[{arm().joints[j]}]"]
            assert level.value == pytest.approx(0.8 * effect.values["level"], rel=0.05)
        if effect.id == "stribeck":
            velocity = found[f"stribeck.velocity[{arm().joints[j]}]"]
            assert abs(velocity.value - 0.05) < 4 * velocity.std + 0.002


def test_its_model_predicts_as_well_as_the_noise_allows():
    from hybrid.recording import Recording
    from hybrid.signals import Sampler, motion_from_recording

    t, q, tau, _ = log(seconds=12.0, seed=9)
    motion = motion_from_recording(
        Recording(t=t, q=q, tau=tau, joints=arm().joints), cutoff=10.0
    )
    low = Sampler(RATE, 10.0, 1)
    moving = motion.mask & (np.abs(motion.v).min(axis=1) > 0.1)
    left = low(tau - after_thirty_seconds().model.predict(motion))[moving]
    torque = np.array([s.torque for s in joint_scales(arm())])
    noise = 0.003 * torque * np.sqrt(10 / (RATE / 2))
    assert np.all(np.sqrt(np.mean(left**2, axis=0)) < 1.6 * noise)


@pytest.mark.parametrize("mass", [0.5, -1.0])
def test_a_payload_is_noticed_at_once_and_weighed_soon(mass):
    at = 12.4
    tracker = tracked(log(seconds=15.0, seed=4, mass=mass, at=at))
    first = tracker.changes[0]
    assert 0 < first.t - at < 0.25 and first.statistic > 50
    assert len(tracker.changes) == 1
    assert tracker.taken[0] == pytest.approx(mass, rel=0.05)
    assert tracker.taken[3] == pytest.approx(0.1 * mass, abs=0.02)


def test_a_heavy_payload_is_noticed_once_and_not_again_as_an_error():
    tracker = tracked(log(seconds=14.5, seed=1, mass=4.0, at=12.0))
    assert len(tracker.changes) == 1
    assert tracker.taken[0] == pytest.approx(4.0, rel=0.03)


def test_an_hour_of_standstill_does_no_harm():
    tracker = tracked(log(seconds=10.0))
    before = tracker.theta, tracker.std
    rng = np.random.default_rng(0)
    t, q, tau, _ = log(seconds=10.0)
    sag = rng.normal(size=6)
    for k in range(3600):  # once a second, to save time
        noisy = q[-1] + 1e-6 * rng.standard_normal(6)
        tracker.update(Sample(10.0 + k, noisy, tau[-1] + sag * np.sin(k / 250)))
    np.testing.assert_array_equal(tracker.theta, before[0])
    np.testing.assert_array_equal(tracker.std, before[1])
    assert not tracker.changes
    moved = tracked((t + 3700, *log(seconds=10.0)[1:]), tracker)
    assert np.abs(moved.error).max() < 3 and not moved.changes
    assert np.all(moved.std <= before[1] * (1 + 1e-9))


def test_a_blow_shifts_nothing_much():
    t, q, tau, links = log()
    hit = tau.copy()
    hit[5000:5005] += 80.0
    plain, struck = after_thirty_seconds(), tracked((t, q, hit, links))
    shift = np.abs(struck.theta - plain.theta) / plain.std
    assert shift.max() < 3 and not struck.changes


def test_gains_stay_physical():
    t, q, tau, links = log(seconds=10.0, noise=5.0)
    tracker = tracked((t, q, tau, links))
    for p in tracker.parameters:
        assert p.lower <= p.value <= p.upper
        if p.name.startswith(("coulomb", "viscous", "stribeck")):
            assert p.value >= 0


def test_with_exact_states_no_filter_is_needed():
    robot, rng = random_arm(3), np.random.default_rng(0)
    links = robot.chain.inertial * rng.uniform(0.9, 1.1, (robot.size, 1))
    q, v, a = random_states(robot.size, 300, 1)
    tau = inverse_dynamics(robot.chain, links, q, v, a)
    tracker = OnlineIdentifier(
        robot, rate=100.0, cutoff=np.inf, memory=1e6, noise=np.full(robot.size, 1e-3)
    )
    for k in range(300):
        tracker.update(Sample(k / 100, q[k], tau[k], v[k], a[k]))
    size = tracker.problem.size
    truth = tracker.problem.base.mapping[:size] @ links.ravel()
    np.testing.assert_allclose(tracker.theta, truth, rtol=1e-3, atol=1e-3)
    assert tracker.delay == 0
    with pytest.raises(IdentificationError, match="speed and acceleration"):
        tracker.update(Sample(3.0, q[0], tau[0]))


def test_it_goes_on_from_a_model_and_gives_one_back():
    model = after_thirty_seconds().model
    again = OnlineIdentifier.from_model(model, rate=RATE)
    assert isinstance(model, DynamicModel) and again.model.effects == model.effects
    p = again.problem.size
    np.testing.assert_allclose(again.theta[:p], after_thirty_seconds().theta[:p])
    tracked(log(seconds=10.0, seed=0), again)
    assert np.abs(again.error).max() < 3


@pytest.mark.parametrize("band", [np.inf, 2.5])
def test_what_a_model_foretells_does_not_change_it(band):
    """A knee has dependent columns, and a logger may have filtered the torque."""
    robot = Robot.load(MODELS / "planar.xml")
    knee = {"coulomb_positive": 1.0, "coulomb_negative": 1.5, "rising": 4.0,
            "threshold": 0.5, "width": 0.02}  # fmt: skip
    problem = build_problem(robot.chain, effects := [ThresholdFriction((1,), knee)])
    size = 10 * robot.size
    base = problem.base.with_values(
        problem.base.mapping[:, :size] @ robot.chain.inertial.ravel()
    )
    seen = {"v_max": np.full(2, 3.0)}
    model = DynamicModel(
        robot, base, tuple(effects), cutoff=20.0, band=band, range=seen
    )
    motion = random_fourier(robot, duration=20.0, rate=RATE, seed=0)
    tau = Sampler(RATE, band, 1)(model.predict(motion))
    tracker = OnlineIdentifier.from_model(model, rate=RATE)
    tracked((motion.t, motion.q, tau, None), tracker)
    (found,) = tracker.model.effects
    for name, value in knee.items():
        assert found.values[name] == pytest.approx(value, abs=0.05)
    assert (tracker.model.cutoff, tracker.model.band) == (20.0, band)
    assert tracker.model.range == seen
    assert repr(tracker) == (
        "<OnlineIdentifier of planar at 250 Hz: 5,001 of 5,001 samples used>"
    )


def test_what_cannot_be_tracked_is_refused():
    with pytest.raises(IdentificationError, match="delay changes signals"):
        OnlineIdentifier(arm(), [Delay((2,))], rate=RATE)
    with pytest.raises(IdentificationError, match="thermal_friction warms with use"):
        OnlineIdentifier(arm(), [ThermalFriction((2,))], rate=RATE)
    with pytest.raises(IdentificationError, match="above 0"):
        OnlineIdentifier(arm(), [Coulomb((0,))], rate=0.0)


def test_a_shape_that_is_chosen_is_not_tracked():
    """The speed up to which friction was seen is no property of the joint."""
    robot = Robot.load(MODELS / "planar.xml")
    effects = effects_from_text(
        "threshold_friction:shoulder", robot.joints, joint_scales(robot)
    )
    tracker = OnlineIdentifier(robot, effects, rate=200.0)
    sure = {p.name: p.std for p in tracker.parameters}
    assert sure["threshold_friction.fastest[shoulder]"] == 0.0
    assert sure["threshold_friction.threshold[shoulder]"] > 0.0
