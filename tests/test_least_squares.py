"""Estimators: generalised least squares, bounds, outliers, and honest intervals."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from marks import studied
from simulated import (
    arm,
    coloured,
    data_of,
    errors_alike,
    linear_problem,
    motions,
    solve,
    stacked,
    with_torque,
)

from hybrid.errors import IdentificationError
from hybrid.regression.cross_products import accumulate
from hybrid.regression.intervals import condition_number, with_uncertainty
from hybrid.regression.least_squares import ESTIMATORS, solve_weighted, without_folds
from hybrid.regression.problem import build_problem
from hybrid.signals import Sampler


class Bench:
    """An exactly linear arm: columns made once, any noise on top of a known truth."""

    def __init__(self, name, *, cutoff=np.inf, **options):
        self.robot = arm(name)
        self.problem = linear_problem(self.robot)
        self.motions = motions(self.robot, **options)
        self.cutoff, self.n = cutoff, self.robot.size
        self.truth = np.random.default_rng(7).uniform(0.5, 1.5, self.problem.size)
        self.columns = [stacked(self.problem, m) for m in self.motions]

    def logs(self, noise):
        """Motions with the true torque and some noise, shape (N, n) for each."""
        return [
            with_torque(m, Y @ self.truth + e)
            for m, Y, e in zip(self.motions, self.columns, noise, strict=True)
        ]

    def white(self, seed, covariance):
        rng = np.random.default_rng(seed)
        return [coloured(rng, len(m.t), covariance, 0.0) for m in self.motions]

    def products(self, logs, **options):
        return accumulate(self.problem, data_of(logs, cutoff=self.cutoff, **options))

    def generalised(self, logs, weight):
        """Generalised least squares on the whole stacked matrix."""
        root = np.linalg.cholesky(weight).T
        rows = [np.einsum("ij,njp->nip", root, Y) for Y in self.columns]
        Y = np.concatenate(rows).reshape(-1, self.problem.size)
        tau = np.concatenate([m.tau @ root.T for m in logs]).ravel()
        return np.linalg.lstsq(Y, tau, rcond=None)[0]

    def residual(self, logs, theta):
        pairs = zip(logs, self.columns, strict=True)
        return np.concatenate([m.tau - Y @ theta for m, Y in pairs])


@pytest.fixture(scope="module")
def planar():
    return Bench("planar")


@pytest.fixture(scope="module")
def six_axes():
    return Bench("coman_like")


# Noise of very different size, alike on neighbouring joints.
def covariance_of(n, correlation):
    size = np.geomspace(1.0, 0.1, n)
    return errors_alike(n, correlation) * np.outer(size, size)


# --- what is solved -------------------------------------------------------------------


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_exact_torque_returns_the_truth(six_axes, estimator):
    logs = six_axes.logs([0.0, 0.0])
    found = solve(six_axes.products(logs), estimator)
    np.testing.assert_allclose(found.theta, six_axes.truth, rtol=1e-6)
    assert found.undetermined == () and found.converged


def test_ordinary_least_squares_weighs_all_joints_alike(six_axes):
    logs = six_axes.logs(six_axes.white(0, covariance_of(6, 0.8)))
    found = solve(six_axes.products(logs), "ls")
    expected = six_axes.generalised(logs, np.eye(6))
    np.testing.assert_allclose(found.theta, expected, rtol=0, atol=1e-8)


def test_weighted_least_squares_weighs_by_the_variance_of_each_joint(six_axes):
    logs = six_axes.logs(six_axes.white(1, covariance_of(6, 0.8)))
    found = solve(six_axes.products(logs), "wls")
    theta, freedom = six_axes.generalised(logs, np.eye(6)), 2002 - 54 / 6
    for _ in range(2):
        variance = (six_axes.residual(logs, theta) ** 2).sum(axis=0) / freedom
        theta = six_axes.generalised(logs, np.diag(1 / variance))
    np.testing.assert_allclose(found.theta, theta, rtol=0, atol=1e-8)
    assert np.count_nonzero(found.weight) == 6


def test_iterated_least_squares_is_generalised_least_squares_at_its_own_noise(six_axes):
    logs = six_axes.logs(six_axes.white(2, covariance_of(6, 0.8)))
    found = solve(six_axes.products(logs), "irls")
    assert found.converged
    expected = six_axes.generalised(logs, found.weight)
    np.testing.assert_allclose(found.theta, expected, rtol=0, atol=1e-8)
    residual = six_axes.residual(logs, expected)
    sigma, known = residual.T @ residual / (2002 - 54 / 6), len(found.share)
    sigma[~np.eye(6, dtype=bool)] *= known / (known + 7)  # its prior: no correlation
    np.testing.assert_allclose(found.weight @ sigma, np.eye(6), atol=1e-4)
    np.testing.assert_allclose(found.sigma, covariance_of(6, 0.8), rtol=0.2, atol=1e-3)


def test_noise_alike_on_all_joints_costs_iterated_least_squares_less(six_axes):
    """Equal variances: what plain weights cannot use, the full covariance does."""
    covariance = errors_alike(6, 0.9)
    Y = np.concatenate(six_axes.columns)
    gram = np.einsum("nip,niq->pq", Y, Y)
    inner = np.einsum("nip,ij,njq->pq", Y, covariance, Y, optimize=True)
    weighted = np.einsum(
        "nip,ij,njq->pq", Y, np.linalg.inv(covariance), Y, optimize=True
    )
    plain = np.linalg.solve(gram, np.linalg.solve(gram, inner).T)
    size = np.sqrt(np.diag(plain))
    expected = np.sqrt(np.mean(np.diag(np.linalg.inv(weighted)) / size**2))
    square = dict.fromkeys(ESTIMATORS, 0.0)
    for seed in range(8):
        products = six_axes.products(six_axes.logs(six_axes.white(seed, covariance)))
        for name in ESTIMATORS:
            error = (solve(products, name).theta - six_axes.truth) / size
            square[name] += np.mean(error**2) / 8
    ratio = np.sqrt(square["irls"] / square["ls"])
    assert ratio < 0.75 and ratio < 0.8 * np.sqrt(square["wls"] / square["ls"])
    assert ratio == pytest.approx(expected, rel=0.1)


def test_a_short_log_is_not_left_to_one_combination_of_joints(six_axes):
    """46 samples of 54 unknowns: the likelihood of a full covariance has no maximum."""
    short = Bench("coman_like", duration=2.0, cutoff=3.0)
    unseen, squares = np.concatenate(six_axes.columns), dict.fromkeys(ESTIMATORS, 0.0)
    for seed in range(10):
        products = short.products(short.logs(short.white(seed, covariance_of(6, 0.6))))
        found = {x: solve_weighted(products, x) for x in ESTIMATORS}
        assert found["irls"].converged
        for name, x in found.items():
            squares[name] += np.sum((unseen @ (x.theta - short.truth)) ** 2)
    assert squares["irls"] < squares["wls"]


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_the_unit_of_torque_does_not_matter(planar, estimator, factor):
    logs = planar.logs(planar.white(3, covariance_of(2, 0.5)))
    other = [with_torque(m, factor * m.tau) for m in logs]
    products = [planar.products(x) for x in (logs, other)]
    found, scaled = (solve(x, estimator) for x in products)
    pairs = zip(products, (found, scaled), strict=True)
    condition, of_scaled = (condition_number(x.normal(y.weight)[0]) for x, y in pairs)
    assert of_scaled == pytest.approx(condition, rel=1e-4)
    np.testing.assert_allclose(scaled.theta, factor * found.theta, rtol=1e-5)
    np.testing.assert_allclose(scaled.std, factor * found.std, rtol=1e-4)


# --- bounds ---------------------------------------------------------------------------


def test_bounded_gains_are_optimal_and_physical(six_axes):
    """Friction of half the joints is none: without bounds noise makes some negative."""
    bench = six_axes
    lower = bench.problem.lower
    friction = np.flatnonzero(lower == 0.0)
    assert len(friction) == 12  # viscous and dry; offsets may have either sign
    truth = bench.truth.copy()
    truth[friction[::2]] = 0.0
    noise = bench.white(4, 4 * covariance_of(6, 0.5))
    logs = [
        with_torque(m, Y @ truth + e)
        for m, Y, e in zip(bench.motions, bench.columns, noise, strict=True)
    ]
    products = bench.products(logs)
    free = solve(products, "irls")
    assert (free.theta[friction] < 0).sum() >= 2
    found = solve(products, "irls", bounded=True)
    at_bound = found.theta <= lower
    assert (found.theta >= lower).all() and at_bound.sum() >= 2
    # Optimal: no slope along what is free, and one that presses against the bounds.
    A, b = products.normal(found.weight)
    slope = (A @ found.theta - b) / np.sqrt(np.diag(A))
    size = np.linalg.norm(b / np.sqrt(np.diag(A)))
    assert np.abs(slope[~at_bound]).max() < 1e-7 * size
    assert slope[at_bound].min() > 0
    # A bound makes no value sure: the truth, which lies there, is within reach.
    assert found.std.min() > 0
    assert (np.abs(found.theta - truth)[at_bound] < 4 * found.std[at_bound]).all()


def test_bounds_that_do_not_bind_change_nothing(planar):
    products = planar.products(planar.logs(planar.white(5, 1e-4 * np.eye(2))))
    free, found = (solve(products, "irls", bounded=x) for x in (False, True))
    np.testing.assert_array_equal(found.theta, free.theta)
    np.testing.assert_array_equal(found.covariance, free.covariance)


# --- stretches that do not fit --------------------------------------------------------


def test_robust_weights_resist_a_gross_stretch(planar):
    """For a second a cable pulls with fifty times the noise."""
    bench = planar
    noise = bench.white(6, 0.04 * np.eye(2))
    clean = solve(bench.products(bench.logs(noise)), "irls")
    noise[0][400:500] += 10.0
    products = bench.products(bench.logs(noise))
    error = {
        robust: np.linalg.norm(
            (solve(products, "irls", robust=robust).theta - bench.truth) / clean.std
        )
        for robust in (False, True)
    }
    honest = np.linalg.norm((clean.theta - bench.truth) / clean.std)
    assert error[False] > 10 * honest
    assert error[True] < 2 * honest


def test_robust_weights_leave_clean_data_alone(planar):
    products = planar.products(planar.logs(planar.white(7, np.eye(2))))
    plain, robust = (solve(products, "irls", robust=x) for x in (False, True))
    assert np.abs((robust.theta - plain.theta) / plain.std).max() < 0.1


# --- what cannot be told --------------------------------------------------------------


def test_unknowns_that_the_motion_leaves_open_are_named(planar):
    """With the elbow at rest at one angle, all of its own terms are open."""
    still = [
        replace(m, q=m.q * [1, 0], v=m.v * [1, 0], a=m.a * [1, 0])
        for m in planar.motions
    ]
    columns = [stacked(planar.problem, m) for m in still]
    logs = [
        with_torque(m, Y @ planar.truth) for m, Y in zip(still, columns, strict=True)
    ]
    products = planar.products(logs)
    found = solve(products, "ls")
    labels = planar.problem.base.kept_labels
    open_ = {labels[k] for k in found.undetermined}
    assert {"viscous.coefficient[elbow]", "coulomb.level[elbow]"} <= open_
    assert not open_ & {"viscous.coefficient[shoulder]", "coulomb.level[shoulder]"}
    assert condition_number(products.normal(found.weight)[0]) > 1e6
    # What they give together is still right.
    for motion, Y in zip(logs, columns, strict=True):
        np.testing.assert_allclose(Y @ found.theta, motion.tau, atol=1e-6)


def test_more_unknowns_than_samples_are_refused(planar):
    few = np.zeros(len(planar.motions[0].t), dtype=bool)
    few[::300] = True
    logs = [replace(m, mask=few) for m in planar.logs([0.0, 0.0])][:1]
    with pytest.raises(IdentificationError, match="longer recordings are needed"):
        solve(planar.products(logs))


def test_each_fold_is_scored_by_the_others(planar):
    logs = planar.logs(planar.white(8, covariance_of(2, 0.5)))
    folds = [((m.t + 3 * k) // 1.0).astype(int) % 4 for k, m in enumerate(logs)]
    products = planar.products(logs, folds=folds)
    estimate = solve(products, "irls")
    found = without_folds(products, estimate)
    squares = products.held_out_squares(found)
    for k in range(4):
        rest = [replace(m, mask=f != k) for m, f in zip(logs, folds, strict=True)]
        held = [replace(m, mask=f == k) for m, f in zip(logs, folds, strict=True)]
        A, b = planar.products(rest).normal(estimate.weight)
        theta = np.linalg.solve(A, b)
        np.testing.assert_allclose(found[k], theta, rtol=1e-8)
        left = np.diag(planar.products(held).residual_products(theta))
        of_fold = squares[products.data.block_folds == k].sum(axis=0)
        np.testing.assert_allclose(of_fold, left, rtol=1e-8)
    samples = sum(len(m.t) for m in logs)
    assert (squares.sum(axis=0) / samples > np.diag(estimate.sigma)).all()


# --- intervals ------------------------------------------------------------------------


def hits(bench, seeds, seconds, estimator="irls"):
    """Whether the 95 % interval of each unknown holds the truth, for each seed.

    Noise is alike on neighbouring joints, of unequal size, and forgets with a time
    constant of some seconds.
    """
    rate = bench.motions[0].rate
    memory = np.exp(-1 / (rate * seconds)) if seconds else 0.0
    covariance, found = covariance_of(bench.n, 0.6), []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noise = [coloured(rng, len(m.t), covariance, memory) for m in bench.motions]
        low, high = solve(bench.products(bench.logs(noise)), estimator).interval()
        found.append((low <= bench.truth) & (bench.truth <= high))
    return np.array(found)


@pytest.fixture(scope="module")
def minute():
    """Eighty seconds of a planar arm at 100 Hz, filtered at 10 Hz."""
    return Bench("planar", duration=40.0, cutoff=10.0)


@pytest.mark.parametrize("seconds", [0.2, *studied(0.0, 0.05)])
def test_intervals_cover_the_truth_as_often_as_they_say(minute, seconds):
    assert 0.92 <= hits(minute, 50, seconds).mean() <= 0.97


def test_intervals_of_ordinary_least_squares_are_as_honest(minute):
    assert 0.92 <= hits(minute, 50, 0.2, "ls").mean() <= 0.97


def test_intervals_of_six_joints_are_as_honest():
    bench = Bench("coman_like", duration=40.0, cutoff=10.0)
    assert 0.92 <= hits(bench, 12, 0.1).mean() <= 0.97


def test_intervals_that_take_samples_for_independent_would_not_be(minute):
    """The noise is no straw man: the textbook's intervals hold half as often."""
    found = 0
    rate, seeds = minute.motions[0].rate, 20
    sampler = Sampler.for_rate(rate, minute.cutoff)
    columns = np.concatenate([sampler(Y) for Y in minute.columns])
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        noise = [
            coloured(rng, len(m.t), covariance_of(2, 0.6), np.exp(-1 / (rate * 0.2)))
            for m in minute.motions
        ]
        estimate = solve(minute.products(minute.logs(noise)), "irls")
        textbook = np.linalg.inv(
            np.einsum("nip,ij,njq->pq", columns, estimate.weight, columns)
        )
        error = np.abs(estimate.theta - minute.truth)
        found += np.mean(error < 1.96 * np.sqrt(np.diag(textbook))) / seeds
    assert found < 0.7


def test_a_gain_that_was_left_out_is_unknown_to_the_intervals(minute):
    """One no larger than noise makes it look: its neighbours take it over."""
    effects = minute.problem.effects
    without = [(k, "coefficient") for k, e in enumerate(effects) if e.id == "viscous"]
    problem = build_problem(minute.robot.chain, effects, without=without)
    bench, whole = copy(minute), copy(minute)
    bench.problem, whole.problem = problem, problem.complete()
    viscous = [u for u, e, _ in minute.problem.gains if effects[e].id == "viscous"]
    assert len(viscous) == whole.problem.size - problem.size == minute.n
    known, shares = np.delete(minute.truth, viscous), []
    dry = [u for u, e, _ in problem.gains if effects[e].id == "coulomb"]
    for seed in range(25):
        logs = minute.logs(minute.white(seed, covariance_of(minute.n, 0.6)))
        found = solve(minute.products(logs))
        size = np.random.default_rng(seed).normal(0.0, found.std[viscous])
        less = minute.truth[viscous] - size
        pairs = zip(logs, minute.columns, strict=True)
        logs = [with_torque(m, m.tau - Y[:, :, viscous] @ less) for m, Y in pairs]
        few, all_ = bench.products(logs), whole.products(logs)
        chosen = solve_weighted(few, "irls")
        intervals = [
            with_uncertainty(few, chosen, complete=x).interval() for x in (None, all_)
        ]
        inside = [(low <= known) & (known <= high) for low, high in intervals]
        shares.append(np.array(inside)[:, dry])
    taken_for_zero, unknown = np.mean(shares, axis=(0, 2))
    assert taken_for_zero < 0.85
    assert unknown >= 0.92
