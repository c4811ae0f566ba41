"""Cross-products: the same numbers as the stacked columns, whatever is done to them."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from arms import random_arm
from hypothesis import given, settings
from hypothesis import strategies as st
from simulated import (
    arm,
    data_of,
    linear_problem,
    motions,
    solve,
    stacked,
    with_torque,
)

from hybrid.errors import IdentificationError
from hybrid.regression.cross_products import accumulate
from hybrid.regression.prior import Prior
from hybrid.signals import Sampler

EVERYTHING = -1.0  # no joint is slower: none counts as standing


def loaded(robot, *, seed=0, **options):
    """Motions with a torque that no model explains."""
    rng = np.random.default_rng(seed)
    found = motions(robot, seed=seed, **options)
    return [with_torque(m, rng.normal(size=m.q.shape)) for m in found]


def crossed(problem, chosen, **options):
    return accumulate(problem, data_of(chosen, **options))


def dense(problem, chosen, weight, *, cutoff=np.inf, standing=EVERYTHING):
    """Normal equations from columns filtered in one piece and stacked."""
    A, b = np.zeros((problem.size, problem.size)), np.zeros(problem.size)
    for motion in chosen:
        sampler = Sampler.for_rate(motion.rate, cutoff)
        use = (np.abs(motion.v) > standing) & motion.mask[:, None]
        use = use[:: sampler.factor]
        Y = sampler(stacked(problem, motion)) * use[:, :, None]
        tau = sampler(motion.tau) * use
        A += np.einsum("nip,ij,njq->pq", Y, weight, Y, optimize=True)
        b += np.einsum("nip,ij,nj->p", Y, weight, tau, optimize=True)
    return A, b


def some_weight(n, seed):
    root = np.random.default_rng(seed).normal(size=(n, n))
    return root @ root.T + np.eye(n)


def assert_same(found, expected, tolerance):
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance * size)


@pytest.mark.parametrize("cutoff", [np.inf, 8.0])
def test_normal_equations_are_those_of_the_stacked_matrix(cutoff):
    robot = arm("coman_like")
    problem, chosen = linear_problem(robot), loaded(robot)
    weight = some_weight(robot.size, 0)
    products = crossed(problem, chosen, cutoff=cutoff, standing=0.05)
    A, b = products.normal(weight)
    A_dense, b_dense = dense(problem, chosen, weight, cutoff=cutoff, standing=0.05)
    assert_same(A, A_dense, 1e-12)
    assert_same(b, b_dense, 1e-12)


@settings(max_examples=10)
@given(st.integers(0, 2**32 - 1))
def test_so_they_are_for_random_chains_and_weights(seed):
    robot = random_arm(seed)
    problem, chosen = linear_problem(robot), loaded(robot, seed=seed, duration=3.0)
    weight = some_weight(robot.size, seed)
    found, expected = (
        crossed(problem, chosen).normal(weight),
        dense(problem, chosen, weight),
    )
    for x, y in zip(found, expected, strict=True):
        assert_same(x, y, 1e-11)


def test_many_sums_have_their_normal_equations_each():
    robot = arm("coman_like")
    products = crossed(linear_problem(robot), loaded(robot))
    weight = some_weight(robot.size, 3)
    A, b = products.normal(weight, products.blocks)
    for k, sums in enumerate(products.blocks):
        A_k, b_k = products.normal(weight, sums)
        assert_same(A[k], A_k, 1e-14)
        assert_same(b[k], b_k, 1e-14)


def test_the_solution_is_that_of_dense_least_squares():
    robot = arm("coman_like")
    problem, chosen = linear_problem(robot), loaded(robot)
    found = solve(crossed(problem, chosen), "ls").theta
    Y = np.concatenate([stacked(problem, m).reshape(-1, problem.size) for m in chosen])
    tau = np.concatenate([m.tau.ravel() for m in chosen])
    size = np.linalg.norm(Y, axis=0)
    expected = np.linalg.lstsq(Y / size, tau, rcond=None)[0] / size
    assert_same(found * size, expected * size, 1e-9)


@pytest.mark.parametrize("cutoff", [np.inf, 20.0])
def test_a_log_of_many_chunks_counts_as_one_piece(cutoff):
    """Sixty thousand samples, far more than are held at a time."""
    robot = arm("planar")
    problem = linear_problem(robot)
    (motion,) = loaded(robot, count=1, duration=60.0, rate=1000.0)
    products = crossed(problem, [motion], cutoff=cutoff, standing=0.01)
    weight = some_weight(2, 1)
    expected = dense(problem, [motion], weight, cutoff=cutoff, standing=0.01)
    for x, y in zip(products.normal(weight), expected, strict=True):
        assert_same(x, y, 1e-12 if cutoff == np.inf else 1e-6)


def test_recordings_add_up_in_any_order():
    robot = arm("planar")
    problem = linear_problem(robot)
    first, second, third = loaded(robot, count=3)
    whole = crossed(problem, [first, second, third]).total
    parts = sum(crossed(problem, [m]).total for m in (third, first, second))
    assert_same(parts, whole, 1e-13)


def test_folds_add_up_and_hold_their_own_samples_only():
    robot = arm("planar")
    problem, chosen = linear_problem(robot), loaded(robot)
    folds = [(m.t // 0.7).astype(int) % 3 for m in chosen]  # across the blocks
    products = crossed(problem, chosen, folds=folds)
    assert_same(products.folds.sum(axis=0), products.total, 1e-13)
    for k, found in enumerate(products.folds):
        alone = [
            replace(m, mask=fold == k) for m, fold in zip(chosen, folds, strict=True)
        ]
        assert_same(found, crossed(problem, alone).total, 1e-13)


def test_residual_products_are_those_of_the_residuals():
    robot = arm("coman_like")
    problem, chosen = linear_problem(robot), loaded(robot)
    products = crossed(problem, chosen)
    theta = np.random.default_rng(0).normal(size=problem.size)
    left = np.concatenate([m.tau - stacked(problem, m) @ theta for m in chosen])
    assert_same(products.residual_products(theta), left.T @ left, 1e-11)
    each = products.residual_products(theta, products.blocks)
    assert_same(each.sum(axis=0), left.T @ left, 1e-11)


def test_what_a_joint_shows_while_it_stands_or_is_masked_does_not_count():
    robot = arm("planar")
    problem, chosen = linear_problem(robot), loaded(robot)
    chosen = [replace(m, mask=m.t < 8.0) for m in chosen]
    before = crossed(problem, chosen, standing=0.3)
    spoiled = []
    for m in chosen:
        idle = (np.abs(m.v) <= 0.3) | ~m.mask[:, None]
        spoiled.append(with_torque(m, np.where(idle, 1e6, m.tau)))
    after = crossed(problem, spoiled, standing=0.3)
    np.testing.assert_array_equal(before.total, after.total)
    moving = sum(((np.abs(m.v) > 0.3) & m.mask[:, None]).sum(0) for m in chosen)
    np.testing.assert_array_equal(np.diag(before.counts.sum(axis=0)), moving)


def test_nothing_that_moves_is_said_so():
    robot = arm("planar")
    problem, (motion,) = linear_problem(robot), loaded(robot, count=1)
    nothing = np.zeros_like(motion.mask)
    for chosen, standing in ((replace(motion, mask=nothing), -1.0), (motion, 1e3)):
        with pytest.raises(IdentificationError, match="no usable sample"):
            crossed(problem, [chosen], standing=standing)


def test_memory_does_not_grow_with_the_length_of_the_log():
    robot = arm("planar")
    problem = linear_problem(robot)
    (motion,) = loaded(robot, count=1, duration=100.0, rate=1000.0)
    half = slice(0, len(motion.t) // 2)
    short = replace(
        motion,
        **{x: getattr(motion, x)[half] for x in ("t", "q", "v", "a", "tau", "mask")},
    )
    every = [data_of([chosen], cutoff=20.0) for chosen in (short, motion)]
    assert all(data.block_folds.size for data in every)  # made once, here
    accumulate(problem, every[0])
    peaks, sizes = [], []
    for data in every:
        tracemalloc.start()
        try:
            products = accumulate(problem, data)
            peaks.append(tracemalloc.get_traced_memory()[1])
        finally:
            tracemalloc.stop()
        sizes.append(len(products.counts))
    assert peaks[1] < 1.3 * peaks[0]
    assert max(sizes) <= 256


# --- how sure a solution is -----------------------------------------------------------


def noisy(robot, length, *, size=0.5):
    """Products of a true model with noise that stays for ``length`` samples."""
    rng, problem = np.random.default_rng(1), linear_problem(robot)
    theta = rng.normal(size=problem.size)
    chosen = []
    for m in motions(robot, count=2, duration=60.0, rate=50.0):
        n = len(m.t)
        steps = rng.normal(size=(-(-n // length), robot.size))
        noise = size * np.repeat(steps, length, axis=0)[:n]
        chosen.append(with_torque(m, stacked(problem, m) @ theta + noise))
    return problem, crossed(problem, chosen), theta


def test_intervals_hold_the_truth_when_noise_outlasts_a_block():
    robot, errors = arm("planar"), []
    for length in (1, 400):
        _, products, theta = noisy(robot, length)
        found = solve(products, "wls")
        errors.append(np.sqrt(np.mean(((found.theta - theta) / found.std) ** 2)))
    assert max(errors) < 1.7 and min(errors) > 0.4


def test_blocks_that_follow_each_other_alike_count_for_fewer_than_in_another_order():
    problem, products, _ = noisy(arm("planar"), 400)
    offsets = [k for k, x in enumerate(problem.base.kept_labels) if "offset" in x]
    order = np.random.default_rng(0).permutation(len(products.counts))
    mixed = replace(
        products, blocks=products.blocks[order], counts=products.counts[order]
    )
    found, shuffled = solve(products, "wls"), solve(mixed, "wls")
    np.testing.assert_allclose(found.theta, shuffled.theta, rtol=1e-9)
    assert (found.std / shuffled.std)[offsets].min() > 1.3


def test_a_prior_moves_from_nothing_to_all_as_it_grows_certain():
    problem, products, _ = noisy(arm("planar"), 1)
    mean, p = np.full(problem.size, 3.0), problem.size
    free = solve(products, "wls")
    weak, usual, strong = (
        solve(products, "wls", prior=Prior(mean, k * np.eye(p)))
        for k in (1e-9, 1e2, 1e12)
    )
    np.testing.assert_allclose(weak.theta, free.theta, rtol=1e-6)
    np.testing.assert_allclose(weak.std, free.std, rtol=1e-3)
    assert weak.held == () and strong.held == tuple(range(p))
    np.testing.assert_allclose(strong.theta, mean, atol=1e-6)
    # Where data say nothing, the prior's own doubt is what is left, or somewhat more.
    assert (strong.std >= 0.999e-6).all() and (strong.std < 1e-5).all()
    assert np.linalg.norm(usual.theta - mean) < np.linalg.norm(free.theta - mean)


def test_a_prior_in_proportion_to_the_data_shares_their_doubt():
    problem, products, _ = noisy(arm("planar"), 1)
    A, _ = products.normal(np.eye(problem.chain.size))
    alone = solve(products, "ls")
    found = solve(products, "ls", prior=Prior(alone.theta, 2.0 * A))
    weight = found.weight[0, 0]  # one over the variance of the noise
    np.testing.assert_allclose(found.theta, alone.theta, rtol=1e-6)
    # The data's part of the doubt shrinks with their share; the prior's is its own.
    data = (weight / (weight + 2.0)) ** 2 * np.diag(alone.covariance)
    own = 2.0 / (weight + 2.0) ** 2 * np.diag(np.linalg.inv(A))
    factor = (np.diag(found.covariance) - data) / own
    np.testing.assert_allclose(factor, np.median(factor), rtol=0.2)
    assert 0.9 < np.median(factor) < 1.5


def test_blocks_far_off_are_weighed_down_only_where_that_is_asked_for():
    robot = arm("planar")
    problem, _, theta = noisy(robot, 1)
    (m,) = motions(robot, count=1, duration=60.0, rate=50.0)
    noise = 0.1 * np.random.default_rng(2).normal(size=m.q.shape)
    noise[1000:1150] += 30.0  # someone leans on the arm
    products = crossed(problem, [with_torque(m, stacked(problem, m) @ theta + noise)])
    usual, plain, robust = (
        np.abs(solve(products, "wls", **options).theta - theta).max()
        for options in ({}, {"robust": False}, {"robust": True})
    )
    assert usual == plain
    assert robust < 0.2 * plain
