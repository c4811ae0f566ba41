"""Intervals, priors, bounds and weak directions of the regression by closed forms."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pendulum import pendulum, swings, with_torque
from scipy.optimize import lsq_linear
from scipy.stats import t as student
from simulated import data_of

from hybrid.calibration.solve import KinematicSolution
from hybrid.effects import Scale
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.delay import Delay
from hybrid.effects.saturation import Saturation
from hybrid.effects.torque_offset import TorqueOffset
from hybrid.errors import IdentificationError
from hybrid.regression.cross_products import accumulate, runs_of
from hybrid.regression.intervals import (
    Estimate,
    _held,
    _undetermined,
    _variance_inflation,
    condition_number,
    weak_directions,
)
from hybrid.regression.least_squares import (
    _bounded_solve,
    pseudo_inverse,
    solve_weighted,
)
from hybrid.regression.prior import Prior, file_prior, link_std
from hybrid.regression.problem import build_problem, part
from hybrid.signals import Sampler

# --- uncertainty ----------------------------------------------------------------------


@pytest.mark.parametrize(("level", "inside"), [(None, 0.975), (0.5, 0.75)])
def test_an_interval_is_that_of_students_distribution(level, inside):
    theta, covariance = np.array([1.0, -2.0]), np.diag([4.0, 0.25])
    made = Estimate(
        theta, np.eye(1), np.ones(3), True, None, None,
        covariance, np.eye(1), 7, (),
    )  # fmt: skip
    calibrated = object.__new__(KinematicSolution)
    vars(calibrated).update(x=theta, covariance=covariance, degrees=np.full(2, 7.0))
    for found in (made, calibrated):
        low, high = found.interval(*([] if level is None else [level]))
        np.testing.assert_allclose((low + high) / 2, theta)
        half = (high - low) / 2 / np.array([2.0, 0.5])
        np.testing.assert_allclose(student.cdf(half, 7), inside)


def test_columns_alike_have_the_condition_of_their_angle():
    for cosine in (0.0, 0.5, 0.99):
        A = np.array([[4.0, 2 * 3 * cosine], [2 * 3 * cosine, 9.0]])
        expected = np.sqrt((1 + cosine) / (1 - cosine))
        assert condition_number(A) == pytest.approx(expected)
    assert condition_number(np.diag([1e-8, 1e8])) == pytest.approx(1.0)


def test_a_direction_is_weak_below_a_share_of_the_largest_singular_value():
    A = np.array([[1.0, 0.9], [0.9, 1.0]])  # singular values of roots of 1.9 and 0.1
    share = np.sqrt(0.1 / 1.9)
    assert weak_directions(A, 0.999 * share).shape == (2, 0)
    (found,) = weak_directions(A, 1.001 * share).T
    np.testing.assert_allclose(np.abs(found), np.sqrt(0.5))
    assert found[0] * found[1] < 0


def test_unknowns_are_undetermined_where_a_hundredth_of_them_is():
    """Two columns nearly alike, and a third along their difference."""
    for share, named in ((0.009, (0, 1)), (0.011, (0, 1, 2))):
        apart = np.sqrt(2 * share / (1 - share))
        angle = np.arcsin(apart / 2)
        columns = np.array([
            [np.cos(angle), np.cos(angle), 0.0], [np.sin(angle), -np.sin(angle), 1.0],
        ])  # fmt: skip
        assert _undetermined(columns.T @ columns) == named
    assert _undetermined(np.eye(3)) == ()


def test_a_prior_holds_what_data_have_less_than_half_of_the_influence_on():
    A, prior = np.diag([1.0, 1.0, 4.0]), Prior(np.zeros(3), np.diag([0.99, 1.01, 1.0]))
    assert _held(A, prior) == (1,)
    assert _held(A, None) == ()


@pytest.mark.parametrize("count", [4, 30, 200])
def test_the_variance_of_sums_grows_with_the_correlation_of_blocks(count):
    rng = np.random.default_rng(0)
    series = rng.standard_normal((count, 3)).cumsum(axis=0) * [1.0, 0.0, -1.0]
    series[:, 1] = rng.standard_normal(count)
    series -= series.mean(axis=0)
    recording = (np.arange(count) >= count // 2).astype(int)
    expected = []
    for x in series.T:
        pairs = [
            x[k] * x[k + 1]
            for k in range(count - 1)
            if recording[k] == recording[k + 1]
        ]
        many = max(len(pairs), 5)
        rho = (many * sum(pairs) / (x @ x) + 1) / (many - 4)
        rho = min(max(rho, -0.9), 0.9)
        expected.append((1 + rho) / (1 - rho))
    found = _variance_inflation(series, recording)
    np.testing.assert_allclose(found, expected)
    assert _variance_inflation(0 * series, recording)[0] == pytest.approx(
        (1 + 1 / (max(count - 2, 5) - 4)) / (1 - 1 / (max(count - 2, 5) - 4))
        if count > 10
        else 19.0
    )


# --- bounds ---------------------------------------------------------------------------


@given(seed=st.integers(0, 10_000), size=st.integers(1, 8))
@settings(max_examples=20)
def test_bounded_solutions_are_the_best_above_their_bounds(seed, size):
    rng = np.random.default_rng(seed)
    X, y = rng.standard_normal((20, size)), rng.standard_normal(20)
    lower = np.where(rng.random(size) < 0.3, -np.inf, rng.normal(0, 0.2, size))
    found = _bounded_solve(X.T @ X, X.T @ y, lower)
    expected = lsq_linear(X, y, (lower, np.inf), tol=1e-14).x
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert (found >= lower).all()


def test_the_least_value_of_an_unknown_counts_from_the_gain_it_changes():
    loss = Saturation((1,), {"loss": 0.2, "limit": 5.0})
    late = Delay((0,), {"time": 0.003})
    problem = build_problem(
        pendulum(2).chain, [Coulomb((0,)), TorqueOffset((1,)), loss]
    )
    least = dict(zip(problem.base.kept_labels, problem.lower, strict=True))
    by_effect = {e: least[problem.base.kept_labels[u]] for u, e, _ in problem.gains}
    assert by_effect[0] == 0.0 and by_effect[1] == -np.inf
    assert all(x == -np.inf for x in problem.lower[problem.rigid])
    if loss.changes_signals:
        assert by_effect[2] == -0.2
    changed = build_problem(pendulum(2).chain, [late])
    ((unknown, _, _),) = changed.gains
    theta = np.zeros(changed.size)
    theta[unknown] = 0.001
    (effect,) = changed.fitted(theta)[1]
    assert effect.values["time"] == pytest.approx(0.004)


# --- prior ----------------------------------------------------------------------------


def test_a_link_is_as_unsure_as_its_mass_and_size():
    """Of rods of 2 kg, 0.6 m apart, and of one that is light and small."""
    chain = pendulum(3).chain
    inertial = chain.inertial.copy()
    inertial[2] = [0.1, 0, 0, 0, 4e-5, 0, 9e-5, 0, 0, 1e-5]
    found = link_std(replace(chain, inertial=inertial))
    mass = np.array([2.0, 2.0, 0.1]) + 0.3 * 4.1 / 3
    rod = np.sqrt(0.24 / 2)
    size = np.array([max(rod, 0.3), max(rod, 0.3), max(np.sqrt(9e-5 / 0.1), 0.12)])
    powers = np.array([0] + [1] * 3 + [2] * 6)
    np.testing.assert_allclose(found, mass[:, None] * size[:, None] ** powers)
    long = replace(chain, translation=4 * chain.translation)
    np.testing.assert_allclose(link_std(long)[0, 1] / link_std(long)[0, 0], 1.2)


def test_a_prior_of_gains_is_as_wide_as_their_bounds_or_their_spread():
    effects = [Coulomb((0,)), TorqueOffset((1,))]
    problem = build_problem(pendulum(2).chain, effects)
    prior = file_prior(problem, pendulum(2), [Scale(10.0, 2.0), Scale(4.0, 2.0)])
    std = np.sqrt(np.diag(np.linalg.inv(prior.precision)))
    by_effect = {e: std[u] for u, e, _ in problem.gains}
    assert by_effect == pytest.approx({0: 0.3 * 10.0, 1: 0.3 * 4.0})
    rigid = problem.rigid
    expected = problem.base.mapping[:, :20] @ pendulum(2).chain.inertial.ravel()
    np.testing.assert_allclose(prior.mean[rigid], expected[rigid])
    np.testing.assert_allclose(prior.times(4.0).precision, 4 * prior.precision)
    np.testing.assert_allclose(prior.pull, prior.precision @ prior.mean)


def test_without_a_mass_a_file_says_nothing():
    robot = pendulum(2)
    bare = replace(robot, chain=replace(robot.chain, inertial=np.zeros((2, 10))))
    assert file_prior(build_problem(bare.chain, []), bare, []) is None


# --- sums -----------------------------------------------------------------------------


def products(count=1, seconds=10.0):
    logs = [with_torque(m, (), 0.1) for m in swings(count=count, seconds=seconds)]
    problem = build_problem(pendulum().chain, [])
    return accumulate(problem, data_of(logs, standing=0.0))


def test_a_block_lasts_a_quarter_of_a_second_or_longer_where_logs_are():
    short, long = products(seconds=10.0), products(seconds=40.0)
    assert len(short.blocks) == 10.0 / 0.25 and len(long.blocks) == 96 / 1.2
    assert products(count=2, seconds=5.0).recording.tolist() == [0] * 20 + [1] * 20


def test_a_sample_of_every_unknown_is_too_few():
    problem = build_problem(pendulum().chain, [])
    (m, *_) = swings(count=1, seconds=1.0)
    for samples, enough in ((problem.size, False), (problem.size + 1, True)):
        few = part(m, slice(20, 20 + samples))
        sums = accumulate(problem, data_of([few], standing=0.0))
        if enough:
            solve_weighted(sums, "ls")
            continue
        with pytest.raises(IdentificationError, match="longer recordings are needed"):
            solve_weighted(sums, "ls")


def test_chunks_join_to_the_whole_whatever_their_number():
    x = np.random.default_rng(0).standard_normal((2, 40_000))
    sampler = Sampler.for_rate(1000.0, 20.0)
    assert sampler.factor > 1
    (m, *_) = swings(count=1, seconds=1.0)
    t, q = np.arange(40_000) / 1000.0, x.T
    motion = replace(m, t=t, q=q, v=q, a=q, tau=q, mask=t >= 0)
    problem = SimpleNamespace(rows=lambda few: few.q.T)
    found = data_of([motion], cutoff=20.0).rows(problem, motion)
    first, joined, raw = zip(*found, strict=True)
    assert first == tuple(16384 // sampler.factor * sampler.factor * np.arange(3))
    joined, raw = (np.concatenate(x, axis=1) for x in (joined, raw))
    np.testing.assert_allclose(joined, sampler(x, axis=1), atol=1e-6)
    np.testing.assert_array_equal(raw, x)


def test_runs_end_where_any_label_changes():
    first, second = np.array([0, 0, 1, 1, 1, 0]), np.array([2, 2, 2, 3, 3, 3])
    assert runs_of(first) == [(0, 2), (2, 5), (5, 6)]
    assert runs_of(first, second) == [(0, 2), (2, 3), (3, 5), (5, 6)]


def test_a_part_of_a_motion_has_what_the_whole_has():
    (m, *_) = swings(count=1, seconds=1.0)
    warm = replace(m, temperature=m.q + 20.0, asked=m.tau + 1.0)
    few, here = part(warm, slice(10, 30)), slice(10, 30)
    for name in ("t", "q", "v", "a", "tau", "mask", "temperature", "asked"):
        np.testing.assert_array_equal(getattr(few, name), getattr(warm, name)[here])
    assert part(m, here).temperature is None and part(m, here).asked is None


def test_what_is_left_open_is_zero_in_a_pseudo_inverse():
    A = np.array([[4.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    size = np.array([2.0, 1.0, 1.0])
    expected = np.linalg.pinv(A / size / size[:, None]) / size / size[:, None]
    np.testing.assert_allclose(pseudo_inverse(A), expected, atol=1e-12)
