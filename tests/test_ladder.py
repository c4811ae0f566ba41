"""The ladder's gate, its prior, and what its terms do where nothing was seen."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import arm, linear_problem, motions, quiet, with_torque

from hybrid.dynamics import inverse_dynamics
from hybrid.effects import JointState
from hybrid.effects.threshold_friction import ThresholdFriction
from hybrid.effects.torque_ripple import TorqueRipple
from hybrid.identification import identify, validate
from hybrid.identification.gate import lowers, with_accepted
from hybrid.identification.preparation import decimated_motion
from hybrid.identification.solver import Solver
from hybrid.regression.data import Data
from hybrid.regression.prior import file_prior, link_std
from hybrid.regression.problem import part


def state(v):
    zero = np.zeros_like(v)
    return JointState(zero, zero + 0.1, v, zero, np.sign(v), zero)


# --- the gate -------------------------------------------------------------------------


def test_noise_alone_passes_the_gate_as_often_as_it_may():
    rng = np.random.default_rng(0)
    before = rng.chisquare(100, (48, 4000))
    passed = lowers(before, before + rng.standard_normal(before.shape)).mean()
    assert 0.015 < passed < 0.04  # one in forty is allowed


def test_noise_that_is_common_to_both_hides_no_gain():
    rng = np.random.default_rng(1)
    noise = 1e6 * rng.chisquare(3, (48, 2))
    gain = np.array([1.0, -1.0]) + 0.5 * rng.standard_normal((48, 2))
    assert lowers(noise, noise - gain).tolist() == [True, False]
    assert not lowers(noise, noise).any()


def test_the_best_of_many_rungs_has_to_gain_more():
    rng = np.random.default_rng(2)
    before = np.zeros((48, 2000))
    after = before + rng.standard_normal(before.shape)
    assert lowers(before, after, tried=100).sum() < 0.1 * lowers(before, after).sum()


def test_a_term_refused_at_first_is_judged_beside_those_that_were_accepted():
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((48, 2))
    # Without its own term, joint 1 loses by what joint 0 gains.
    squares = {(): [9.0, 9.0], (0,): [1.0, 10.0], (0, 1): [1.0, 9.1]}

    def fitted(terms):
        common = noise if terms else rng.standard_normal((48, 2))
        return SimpleNamespace(squares=np.array(squares[tuple(sorted(terms))]) + common)

    start, options = fitted({}), [{0: ["a"], 1: ["b"]}]
    assert not lowers(start.squares, fitted(options[0]).squares)[1]
    found = with_accepted(start, options, fitted)
    np.testing.assert_array_equal(found.squares, fitted(options[0]).squares)


def test_a_joint_that_may_be_worse_than_least_squares_counts_against_a_solution():
    rng = np.random.default_rng(4)
    solver = Solver(arm("planar"), None, "irls", robust=False)
    solver.reference = reference = rng.chisquare(20, (48, 2))
    sure, unsure = reference * [0.9, 0.99], reference * [0.89, 0.98]
    unsure[:, 1] *= 1 + 0.4 * rng.permutation(np.linspace(-1, 1, 48))
    unsure *= reference.sum(axis=0) * [0.89, 0.98] / unsure.sum(axis=0)
    assert (unsure.sum(axis=0) < sure.sum(axis=0)).all()
    assert solver.cost(unsure, harm=0.0) < solver.cost(sure, harm=0.0)
    assert solver.cost(unsure) > solver.cost(sure)


# --- the prior ------------------------------------------------------------------------


def scales(robot):
    q = motions(robot, count=1)[0]
    tau = inverse_dynamics(robot.chain, robot.chain.inertial, q.q, q.v, q.a)
    folds = (np.zeros(len(q.t), dtype=int),)
    return Data((with_torque(q, tau),), folds, np.inf, np.zeros(robot.size)).scales


def test_the_prior_expects_the_files_links_and_is_certain_of_none():
    robot = arm("coman_like")
    problem = linear_problem(robot)
    prior = file_prior(problem, robot, scales(robot))
    gains = np.zeros(len(problem.columns))
    expected = problem.base.mapping @ np.append(robot.chain.inertial.ravel(), gains)
    rigid = problem.rigid
    np.testing.assert_allclose(prior.mean[rigid], expected[rigid], rtol=1e-9)
    assert np.linalg.eigvalsh(prior.precision).min() > 0
    std = np.sqrt(np.diag(np.linalg.inv(prior.precision)))
    assert (std[rigid] > 0.3 * np.abs(prior.mean[rigid])).all()


def test_links_ten_times_as_heavy_are_ten_times_as_uncertain():
    chain = arm("coman_like").chain
    heavy = replace(chain, inertial=10 * chain.inertial)
    np.testing.assert_allclose(link_std(heavy), 10 * link_std(chain))


def test_a_file_without_masses_is_no_prior():
    robot = arm("planar")
    empty = robot.with_inertial(0 * robot.chain.inertial)
    assert file_prior(linear_problem(empty), empty, scales(robot)) is None


def test_a_file_that_is_off_helps_where_the_motion_tells_little():
    """Half a minute within a few degrees, then the arm moves anywhere."""
    robot = arm("coman_like")
    rng = np.random.default_rng(3)
    off = robot.chain.inertial * rng.uniform(0.8, 1.2, (robot.size, 1))
    little, wide = [], []
    for found, size in ((little, 0.08), (wide, 1.0)):
        for m in motions(robot, count=3, seed=len(little)):
            q, v, a = (size * x for x in (m.q, m.v, m.a))
            tau = inverse_dynamics(robot.chain, robot.chain.inertial, q, v, a)
            tau += 0.3 * rng.standard_normal(tau.shape)
            found.append(replace(m, q=q, v=v, a=a, tau=tau))
    fit, _ = quiet(identify, robot.with_inertial(off), little, cutoff=10.0)
    rows = {row.name: row for row in validate(fit.model, wide).rows}
    best = rows[fit.model.stage]
    assert best.mean < 0.5 * min(rows["LS"].mean, rows["WLS"].mean)
    assert fit.estimate.held  # and it says what the file holds
    assert any("held by the robot file" in x for x in fit.unidentifiable)


# --- what it is judged on -------------------------------------------------------------


@settings(max_examples=40)
@given(
    sizes=st.lists(st.integers(60, 900), min_size=1, max_size=7), seed=st.integers(0)
)
def test_blocks_are_short_stretches_of_one_log_and_one_fold(sizes, seed):
    rng = np.random.default_rng(seed)
    robot = arm("planar")
    (long,) = motions(robot, count=1, duration=10.0)
    logs = tuple(part(long, slice(0, n)) for n in sizes)
    folds = tuple(np.repeat(rng.integers(0, 4, n // 20 + 1), 20)[:n] for n in sizes)
    data = Data(logs, folds, 10.0, np.full(2, -1.0))
    labels = np.concatenate(data.blocks)
    log = np.repeat(np.arange(len(sizes)), sizes)
    at, fold = np.concatenate([np.arange(n) for n in sizes]), np.concatenate(folds)
    assert set(labels) == set(range(labels.max() + 1))
    each = int(np.ceil(48 / len(sizes)))  # 48 blocks in all, or somewhat more
    for block in range(labels.max() + 1):
        own = labels == block
        assert len(set(log[own])) == len(set(fold[own])) == 1
        assert np.ptp(at[own]) <= np.ceil(sizes[log[own][0]] / each)
    places = {(a, b * each // sizes[a]) for a, b in zip(log, at, strict=True)}
    assert len(places) <= labels.max() + 1 <= 4 * len(places)
    left = [rng.normal(size=m.q.shape) for m in logs]
    total = (np.concatenate(left) ** 2).sum(axis=0)
    np.testing.assert_allclose(data.squares(left).sum(axis=0), total)


# --- outside of what was seen ---------------------------------------------------------


def test_a_ripple_fades_above_the_speed_at_which_it_was_seen():
    v = np.array([0.0, 1.0, 1.5, 2.0, 5.0])
    sine, cosine = TorqueRipple.law(state(v), periods=7.0, fastest=1.0)
    np.testing.assert_allclose(np.hypot(sine, cosine), [1, 1, 0.5, 0, 0], atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_friction_goes_on_as_its_tangent_beyond_the_speeds_seen(sign):
    def law(speed):
        v = sign * np.asarray(speed)
        return np.array(
            ThresholdFriction.law(state(v), threshold=0.2, width=0.0, fastest=2.0)
        )

    inside = np.array([0.5, 1.9])
    np.testing.assert_allclose(law(inside)[6:], sign * np.array([inside**2, inside**3]))
    below, above, far = (law([2.0 - 1e-6, 2.0 + 1e-6, 7.0])[6:, k] for k in range(3))
    np.testing.assert_allclose(below, above, rtol=1e-5)
    slope = sign * np.array([2 * 2.0, 3 * 2.0**2])
    np.testing.assert_allclose(far, above + 5.0 * slope, rtol=1e-5)


def test_a_thinned_motion_has_the_same_laws_and_the_torque_of_its_band():
    robot = arm("planar")
    (motion,) = motions(robot, count=1, rate=1000.0)
    slow = np.sin(2 * np.pi * 5.0 * motion.t)[:, None] * np.ones(2)
    fast = np.sin(2 * np.pi * 300.0 * motion.t)[:, None] * np.ones(2)
    thin = decimated_motion(with_torque(motion, slow + fast), 10.0)
    factor = round(motion.rate / thin.rate)
    assert factor >= 4
    np.testing.assert_array_equal(thin.v, motion.v[::factor])
    inside = slice(20, -20)
    np.testing.assert_allclose(thin.tau[inside], slow[::factor][inside], atol=2e-3)
