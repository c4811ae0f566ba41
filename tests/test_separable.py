"""Separable least squares: right optimum, honest intervals, bounds; effects in arms."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from improved_stribeck_law import ImprovedStribeck
from scipy.signal import lfilter
from separable import Problem, fit_separable
from separable_effects import Log, fit_effects

from hybrid.dynamics import RigidBody
from hybrid.effects import JointState, Scale
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.elasticity import Elasticity
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.effects.transmission_coupling import TransmissionCoupling
from hybrid.errors import IdentificationError
from hybrid.regression.problem import build_problem
from hybrid.robot import Robot
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

T = np.linspace(0, 1, 400)
FREE = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])


def decays(s):
    """Two exponentials, the classic separable problem."""
    return np.exp(-np.outer(T, s))


def problem(y, **options):
    usual = {
        "columns": decays,
        "target": y,
        "bounds": np.array([[0.5, 4.0], [4.0, 60.0]]),
        "gain_bounds": FREE,
    }
    return Problem(**(usual | options))


TRUE = np.array([2.0, 15.0, 1.0, 0.7])
CLEAN = decays(TRUE[:2]) @ TRUE[2:]


def test_two_exponentials_are_found_exactly_from_no_guess():
    fit = fit_separable(problem(CLEAN))
    np.testing.assert_allclose(fit.shapes, TRUE[:2], rtol=1e-6)
    np.testing.assert_allclose(fit.gains, TRUE[2:], rtol=1e-6)
    assert fit.converged and fit.squares < 1e-12 and not fit.at_bound.any()


def test_it_is_the_optimum_of_the_whole_problem():
    from scipy.optimize import least_squares

    rng = np.random.default_rng(1)
    y = CLEAN + 0.05 * rng.standard_normal(len(T))
    whole = least_squares(lambda p: y - decays(p[:2]) @ p[2:], TRUE, xtol=1e-14)
    fit = fit_separable(problem(y))
    assert fit.squares == pytest.approx(2 * whole.cost, rel=1e-9)
    np.testing.assert_allclose(np.append(fit.shapes, fit.gains), whole.x, rtol=1e-3)


@settings(max_examples=20)
@given(scale=st.floats(1e-6, 1e6))
def test_units_of_the_target_do_not_matter(scale):
    fit = fit_separable(problem(scale * CLEAN))
    np.testing.assert_allclose(fit.shapes, TRUE[:2], rtol=1e-4)
    np.testing.assert_allclose(fit.gains, scale * TRUE[2:], rtol=1e-4)


def test_gains_and_shapes_stay_within_bounds_and_say_so():
    gains = np.array([[-np.inf, -np.inf], [np.inf, 0.5]])
    shapes = np.array([[0.5, 4.0], [1.5, 60.0]])
    fit = fit_separable(problem(CLEAN, gain_bounds=gains, bounds=shapes))
    assert fit.gains[1] == pytest.approx(0.5) and fit.shapes[0] == pytest.approx(1.5)
    assert fit.at_bound.tolist() == [True, False, False, True]
    assert fit.std[0] == 0 and fit.std[1] > 0


def test_columns_without_a_shape_are_fitted_along():
    free = np.stack([np.ones_like(T), np.cos(9 * T)], axis=1)
    fit = fit_separable(problem(CLEAN + free @ [0.3, -2.0], free=free))
    np.testing.assert_allclose(fit.others, [0.3, -2.0], atol=1e-5)
    np.testing.assert_allclose(fit.shapes, TRUE[:2], rtol=1e-4)


def test_dependent_columns_are_no_obstacle():
    def twice(s):
        return np.concatenate([decays(s), decays(s)[:, :1]], axis=1)

    free = np.array([[-np.inf] * 3, [np.inf] * 3])
    fit = fit_separable(problem(CLEAN, columns=twice, gain_bounds=free))
    assert fit.squares < 1e-12
    assert fit.gains[0] + fit.gains[2] == pytest.approx(TRUE[2], rel=1e-5)
    assert np.isinf(fit.std[[2, 4]]).all() and fit.std[3] < 1e-6


def test_coordinates_and_shapes_are_inverse():
    p = problem(CLEAN, bounds=np.array([[0.01, -2.0], [4.0, 60.0]]))
    assert p.wide.tolist() == [True, False]
    for u in np.random.default_rng(0).random((5, 2)):
        np.testing.assert_allclose(p.coordinates(p.shapes(u)), u, atol=1e-12)
    assert p.shapes(np.array([0.5, 0.5])) == pytest.approx([0.2, 29.0])


def test_what_the_data_do_not_tell_has_an_endless_interval():
    positive = np.array([[0.0, 0.0], [np.inf, np.inf]])
    fit = fit_separable(problem(np.exp(-2 * T), gain_bounds=positive))
    low, high = fit.interval()
    assert fit.gains[1] < 1e-6
    assert fit.at_bound[3] or high[1] / low[1] > 3  # no second term, no shape of it


@pytest.mark.study
def test_intervals_cover_the_truth_under_correlated_noise():
    inside, t = [], np.linspace(0, 1, 3000)

    def columns(s):
        return np.exp(-np.outer(t, s)) + np.sin(np.outer(40 * t, s))

    clean = columns(TRUE[:2]) @ TRUE[2:]
    for seed in range(60):
        white = np.random.default_rng(seed).standard_normal(len(t))
        y = clean + 0.2 * lfilter([0.3], [1, -0.9], white)
        p = problem(y, columns=columns)
        fit = fit_separable(p, start=TRUE[:2], starts=0)
        low, high = fit.interval()
        inside.append((low <= TRUE) & (high >= TRUE))
    # Independent samples would give a third of the truths their interval.
    assert 0.90 <= np.mean(inside) <= 0.985


def test_wrong_bounds_and_too_few_samples_are_refused():
    with pytest.raises(IdentificationError, match="lower below upper"):
        problem(CLEAN, bounds=np.array([[0.5, 4.0], [0.5, 60.0]]))
    with pytest.raises(IdentificationError, match="3 samples cannot determine 4"):
        problem(CLEAN[:3])


# --- improved Stribeck friction -----------------------------------------------------

LAW = {"coulomb": 3.0, "static": 6.0, "viscous": 4.0, "velocity": 0.05, "width": 0.01}


def friction(v, **values):
    effect = ImprovedStribeck((0,), LAW | values)
    v = np.asarray(v, dtype=float)
    state = JointState(0 * v, 0 * v, v, 0 * v, np.sign(v), 0 * v)
    return np.stack(effect.law(state, **effect.shape_values), -1) @ effect.gain_values


@given(v=st.floats(-3, 3), width=st.floats(0.001, 0.1), velocity=st.floats(0.001, 1))
def test_the_law_is_odd_and_a_line_within_its_width(v, width, velocity):
    shapes = {"width": width, "velocity": velocity}
    assert friction(v, **shapes) == -friction(-v, **shapes)
    ends = friction([0.3 * width, width], **shapes)
    assert ends[0] == pytest.approx(0.3 * ends[1])
    edge = friction([width * (1 - 1e-9), width * (1 + 1e-9)], **shapes)
    assert edge[0] == pytest.approx(edge[1], rel=1e-6)


@given(v=st.floats(0.011, 3))
def test_beyond_its_width_it_is_the_published_law(v):
    expected = 3 + 3 * np.exp(-((v / 0.05) ** 2)) + 4 * v
    assert friction(v) == pytest.approx(expected, rel=1e-12)


# --- effects of an arm ----------------------------------------------------------------


@cache
def two_links():
    """A planar arm of two links in the vertical plane."""
    links = [
        [3, 0.9, 0.1, 0, 0.1, 0, 0.4, 0, 0, 0.45],
        [2, 0.5, 0, 0.1, 0.1, 0, 0.2, 0, 0, 0.25],
    ]
    chain = Chain(
        joints=("first", "second"),
        rotation=np.stack([np.eye(3)] * 2),
        translation=np.array([[0.0, 0, 0], [0.5, 0, 0]]),
        axis=np.array([[0.0, 0, 1]] * 2),
        revolute=np.array([True, True]),
        inertial=np.array(links, dtype=float),
        gravity=np.array([0.0, -9.81, 0]),
        armature=np.zeros(2),
    )
    free, zero = np.full(2, np.inf), np.zeros(2)
    return Robot("planar", chain, -free, free, free, np.full(2, 50.0), zero, zero)


@cache
def arm_log(noise=0.02):
    """Two coupled links with friction, from exact columns and white noise."""
    robot, rng = two_links(), np.random.default_rng(5)
    t = np.arange(0, 20, 0.005)
    w = np.array([0.7, 1.1])
    q = 0.6 * np.sin(np.outer(t, w)) + 0.2 * np.sin(np.outer(t, 3 * w))
    v, a = (np.gradient(x, t, axis=0) for x in (q, np.gradient(q, t, axis=0)))
    motion = Motion(t, q, v, a, 0 * q, np.ones(len(t), dtype=bool))
    body = RigidBody(robot.chain, motion)
    tau = body.load + noise * rng.standard_normal(q.shape)
    for j in range(2):
        tau[:, j] += friction(v[:, j], velocity=0.05 + 0.03 * j) + 0.4
    return robot, motion, body, tau


def test_friction_of_all_joints_is_found_with_an_unknown_rigid_body():
    robot, motion, body, tau = arm_log()
    kept = list(build_problem(robot.chain, ()).base.kept)
    log = Log(motion, body, tau, rigid=body.columns[:, :, kept])
    effects = [
        e for j in range(2) for e in (ImprovedStribeck((j,)), TorqueOffset((j,)))
    ]
    scales = [Scale(50.0, 2.0)] * 2
    fit = fit_effects(effects, [log], scales=scales)
    for j in range(2):
        found = fit.effects[2 * j].values
        for name, x in (LAW | {"velocity": 0.05 + 0.03 * j}).items():
            assert found[name] == pytest.approx(x, rel=0.03)
            low, high = fit.interval(0.999)[2 * j, name]
            assert low <= x <= high
    np.testing.assert_allclose(fit.rms, 0.02, rtol=0.05)


def test_one_joint_with_a_known_rigid_body_leaves_the_others_alone():
    _, motion, body, tau = arm_log()
    log = Log(motion, body, tau - body.load)
    effects = [ImprovedStribeck((1,)), TorqueOffset((1,))]
    fit = fit_effects(effects, [log, log], scales=[Scale(50.0, 2.0)] * 2, cutoff=20.0)
    assert fit.effects[0].values["velocity"] == pytest.approx(0.08, rel=0.05)
    assert fit.effects[0].std["velocity"] < 0.004
    assert np.isnan(fit.rms[0]) and fit.rms[1] < 0.02
    assert fit.effects[1].values["level"] == pytest.approx(0.4, abs=0.01)


def test_effects_that_couple_joints_are_fitted_together():
    _, motion, body, _ = arm_log()
    coupling = TransmissionCoupling.typical((0, 1), [Scale(50.0, 2.0)] * 2)
    effects = [Coulomb((0,), {"level": 2.0}), coupling]
    tau = np.zeros_like(motion.q)
    for effect in effects:
        tau[:, list(effect.joints)] += effect.torque(motion, body)
    fit = fit_effects(effects, [Log(motion, body, tau)], scales=[Scale(50.0, 2.0)] * 2)
    for effect, found in zip(effects, fit.effects, strict=True):
        for name, x in effect.values.items():
            assert found.values[name] == pytest.approx(x, abs=1e-8)


def test_an_effect_that_the_whole_arm_feels_is_fitted_at_all_of_its_joints():
    _, motion, body, _ = arm_log()
    scales = [Scale(50.0, 2.0)] * 2
    twist = Elasticity((1,), {"damping": 0.3})  # to first order
    rub = Coulomb((0,), {"level": 2.0})
    tau = 2e-3 * twist.columns(motion, body)[:, :, 0]  # felt at both joints
    tau[:, [0]] += rub.torque(motion, body)
    assert np.abs(tau[:, 0] - rub.torque(motion, body)[:, 0]).max() > 1e-3
    first = [Elasticity((1,), {"damping": 0.3}), Coulomb((0,))]
    fit = fit_effects(first, [Log(motion, body, tau)], scales=scales)
    assert fit.effects[0].values["compliance"] == pytest.approx(2e-3, rel=1e-6)
    assert fit.effects[1].values["level"] == pytest.approx(2.0, rel=1e-6)
    assert np.all(fit.rms < 1e-8)


def test_nothing_to_fit_is_refused():
    with pytest.raises(IdentificationError, match="one effect and one log"):
        fit_effects([], [], scales=[])
