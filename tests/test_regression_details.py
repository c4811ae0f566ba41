"""Weights and covariances of the regression against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from simulated import (
    arm,
    data_of,
    linear_problem,
    motions,
    solve,
    stacked,
    with_torque,
)

from hybrid.regression import intervals
from hybrid.regression.cross_products import accumulate
from hybrid.regression.least_squares import pseudo_solve, residual_covariance


def products_of(noise, seconds=20.0):
    """Cross-products of a planar arm with a true model and noise, and the truth."""
    robot = arm("planar")
    problem, (m,) = linear_problem(robot), motions(robot, count=1, duration=seconds)
    theta = np.random.default_rng(1).normal(size=problem.size)
    log = with_torque(m, stacked(problem, m) @ theta + noise(m))
    return accumulate(problem, data_of([log])), theta


def white(m):
    return 0.1 * np.random.default_rng(0).normal(size=m.q.shape)


def test_the_covariance_of_few_blocks_is_nearly_that_without_correlation():
    """The mean of the posterior under an inverse Wishart prior (Gelman et al. 2013).

    A block is worth one observation; of two joints the prior is worth three.
    """
    alike = np.random.default_rng(0).normal(size=(2001, 1)) @ [[1.0, 2.0]]
    products, theta = products_of(lambda m: alike[: len(m.t)])
    for count in (1, 4, len(products.counts)):
        few = replace(
            products, blocks=products.blocks[:count], counts=products.counts[:count]
        )
        sigma = residual_covariance(few, theta)
        correlation = sigma[0, 1] / np.sqrt(sigma[0, 0] * sigma[1, 1])
        assert correlation == pytest.approx(count / (count + 3), rel=1e-6)


def test_variances_are_those_of_the_samples_less_the_unknowns():
    products, theta = products_of(white)
    found = residual_covariance(products, theta)
    left = np.diag(products.residual_products(theta))
    samples = np.diag(products.counts.sum(axis=0))
    free = samples - products.problem.size / 2
    np.testing.assert_allclose(np.diag(found), left / free, rtol=1e-7)


def test_a_residual_of_zero_still_has_a_covariance():
    products, theta = products_of(lambda m: 0.0)
    sigma = residual_covariance(products, theta)
    assert np.linalg.eigvalsh(sigma).min() > 0
    power = np.diag(products.residual_products(0.0 * theta)) / len(products.counts)
    assert (np.diag(sigma) < 1e-9 * power).all()


@pytest.mark.parametrize("times", [2.0, 30.0])
def test_a_block_counts_by_how_far_it_is_above_three_medians(times):
    def noise(m):
        x = white(m)
        x[:200] *= np.sqrt(times)
        return x

    products, _ = products_of(noise)
    found = solve(products, "wls", robust=True)
    misfit = np.einsum(
        "bij,ij->b",
        products.residual_products(found.theta, products.blocks),
        found.weight,
    ) / np.trace(products.counts, axis1=1, axis2=2)
    expected = np.minimum(1.0, 3.0 * np.median(misfit) / misfit)
    np.testing.assert_allclose(found.share, expected, rtol=0.15)
    assert (found.share.min() < 0.3) == (times > 10)
    assert found.share.max() == 1.0


def test_what_weights_there_are_depends_on_the_estimator():
    products, _ = products_of(white)
    once, twice, many = (solve(products, x) for x in ("ls", "wls", "irls"))
    assert once.converged and twice.converged and many.converged
    np.testing.assert_array_equal(once.weight, np.eye(2))
    assert not twice.weight[0, 1] and many.weight[0, 1]


@pytest.mark.parametrize("count", [20, 40])
def test_a_covariance_is_that_of_solutions_without_a_block_each(count, monkeypatch):
    """Efron and Stein 1981: (B − 1)/B of the squares about the mean solution.

    The correlation of blocks is taken as none.
    """
    monkeypatch.setattr(intervals, "_variance_inflation", lambda *_: 1.0)
    every, _ = products_of(white)
    few = replace(every, blocks=every.blocks[:count], counts=every.counts[:count])
    found = solve(few, "ls")
    A, b = few.normal(np.eye(2), few.blocks)
    without = [
        pseudo_solve(A.sum(axis=0) - A[k], b.sum(axis=0) - b[k]) for k in range(count)
    ]
    expected = (count - 1) ** 2 / count * np.cov(np.transpose(without))
    told = A.sum(axis=0)  # nothing of what the data leave open
    found_, expected = (told @ x @ told for x in (found.covariance, expected))
    np.testing.assert_allclose(found_, expected, atol=1e-4 * expected.max())
    assert found.degrees == count - 1
