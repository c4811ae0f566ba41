"""The nearest point of cones and half-lines, against its closed form."""

import numpy as np
import pytest

from hybrid.dynamics.cone import nearest_above
from hybrid.dynamics.pseudo_inertia import stacked, unstacked


def least_of(n, numbers, floor=0.0):
    eye = stacked(np.tile(floor * np.eye(4), (n, 1, 1))).reshape(n, 10)
    return np.concatenate([eye.ravel(), numbers])


@pytest.mark.parametrize("floor", [0.0, 0.3])
def test_a_matrix_is_lifted_by_its_eigenvalues_and_a_number_to_its_bound(floor, capfd):
    """With the unit metric the nearest matrix keeps its eigenvectors."""
    rng = np.random.default_rng(0)
    goals = rng.normal(size=(2, 4, 4))
    goals = goals + goals.transpose(0, 2, 1)
    numbers, bounds = np.array([-1.0, 2.0, -5.0]), np.array([0.0, 0.5, -np.inf])
    goal = np.concatenate([stacked(goals).ravel(), numbers])
    found, exact = nearest_above(goal, np.eye(len(goal)), least_of(2, bounds, floor), 2)
    assert exact
    values, vectors = np.linalg.eigh(goals)
    lifted = (vectors * np.maximum(values, floor)[:, None]) @ vectors.transpose(0, 2, 1)
    np.testing.assert_allclose(unstacked(found[:20].reshape(2, 10)), lifted, atol=1e-5)
    np.testing.assert_allclose(found[20:], [0.0, 2.0, -5.0], atol=1e-5)
    assert np.linalg.eigvalsh(unstacked(found[:20].reshape(2, 10))).min() >= (
        floor - 1e-12
    )
    assert capfd.readouterr() == ("", "")


def test_the_metric_decides_which_point_is_nearest():
    goal = np.concatenate([stacked(np.eye(4)[None]).ravel(), [-1.0, 1.0]])
    metric = np.eye(12)
    metric[10:, 10:] = [[2.0, 1.0], [1.0, 2.0]]
    found, _ = nearest_above(goal, metric, least_of(1, np.zeros(2)), 1)
    # Of (x, y) − (−1, 1) with x = 0, the metric is least where y gives way by a half.
    np.testing.assert_allclose(found[10:], [0.0, 0.5], atol=1e-5)
    np.testing.assert_allclose(found[:10], goal[:10], atol=1e-5)
