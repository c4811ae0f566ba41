"""Parts of the design of motions by themselves."""

from dataclasses import replace

import numpy as np
import pytest
from arms import random_arm, random_states

from hybrid.dynamics import regressor
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.viscous import Viscous
from hybrid.excitation import observe
from hybrid.excitation.path import Path
from hybrid.excitation.solver import quadratic_program


@pytest.mark.parametrize("seed", range(3))
def test_rows_are_whitened_and_columns_counted_in_their_sizes(seed):
    chain = random_arm(seed).chain
    n, rng = chain.size, np.random.default_rng(seed)
    q, v, a = random_states(n, 6, seed)
    path = Path(np.arange(6.0), q, v, a, 0 * q)
    effects = [Viscous((0,)), Coulomb((n - 1,))]
    root = np.tril(rng.normal(size=(n, n))) + 3 * np.eye(n)
    seen = observe(chain, effects, covariance=root @ root.T)
    sizes = np.exp(rng.normal(size=seen.size))
    found = replace(seen, scale=sizes).matrix(path, turning_speed=0.0)
    kept = list(seen.base.kept)
    own = np.zeros((6, n, 2))
    own[:, 0, 0], own[:, n - 1, 1] = v[:, 0], np.sign(v[:, n - 1])
    full = np.concatenate([regressor(chain, q, v, a), own], axis=2)[:, :, kept]
    expected = np.linalg.solve(root, full) * sizes
    np.testing.assert_allclose(found, expected, atol=1e-9)
    W = expected.reshape(-1, seen.size)
    gram = replace(seen, scale=sizes).gram(path, turning_speed=0.0)
    np.testing.assert_allclose(gram, W.T @ W, rtol=1e-9, atol=1e-9)


def test_a_quadratic_step_is_that_of_newton_within_its_reach():
    B, gradient = np.array([[2.0, 0.5], [0.5, 1.0]]), np.array([0.4, -0.2])
    newton = -np.linalg.solve(B, gradient)
    free = np.zeros(0), np.zeros((0, 2))
    found = quadratic_program(B, gradient, *free, reach=1.0, penalty=5.0)
    np.testing.assert_allclose(found, newton, atol=1e-5)
    near = quadratic_program(B, gradient, *free, reach=0.1, penalty=5.0)
    assert np.abs(near).max() <= 0.1 and near @ gradient < 0
    # A condition x₀ ≥ 0.1 is kept where it costs more than it gains.
    kept = quadratic_program(
        B, gradient, np.array([0.1]), np.array([[-1.0, 0.0]]), reach=1.0, penalty=5.0
    )
    assert kept[0] == pytest.approx(0.1, abs=1e-4)
    cheap = quadratic_program(
        B, gradient, np.array([0.1]), np.array([[-1.0, 0.0]]), reach=1.0, penalty=1e-3
    )
    assert cheap[0] < 0.0


def test_where_the_solver_fails_no_step_is_taken():
    nothing = np.zeros(0), np.zeros((0, 2))
    step = quadratic_program(np.eye(2), np.full(2, np.nan), *nothing, 1.0, 5.0)
    np.testing.assert_array_equal(step, [0.0, 0.0])
