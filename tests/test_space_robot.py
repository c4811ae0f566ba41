"""The published online identification: its methods do what their names say."""

import numpy as np
import pytest
from space_robot import SAMPLES, TRUE, motion
from space_robot_ours import with_noise
from space_robot_searches import (
    FORGETTING,
    Run,
    faded,
    linear_columns,
    recursive_least_squares,
    swarm,
    swarm_at_once,
)
from space_robot_variances import variances_table


@pytest.fixture(scope="module")
def data():
    return with_noise(motion(), 0.05, 0)


def test_recursive_least_squares_ends_at_the_fading_least_squares_solution(data):
    found = recursive_least_squares(data).path[-1]
    weight = np.sqrt(FORGETTING ** np.arange(SAMPLES)[::-1])[:, None]
    columns, tau = linear_columns(*data[:3]) * weight[..., None], data[3] * weight
    exact = np.linalg.lstsq(columns.reshape(-1, 6), tau.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found[[0, 1, 2, 3, 4, 7]], exact, rtol=1e-5, atol=1e-6)
    assert np.isnan(found[[5, 6]]).all()


@pytest.mark.study
def test_the_cost_of_the_truth_is_that_of_the_noise():
    assert faded(motion(), TRUE[None], SAMPLES)[0] == pytest.approx(0.0, abs=1e-20)
    noisy = faded(with_noise(motion(), 0.05, 0), TRUE[None], SAMPLES)[0]
    count = 2 * (FORGETTING ** np.arange(SAMPLES)).sum()
    assert noisy == pytest.approx(0.05**2 * count, rel=0.4)


@pytest.mark.study
def test_a_swarm_that_knows_the_friction_finds_the_rigid_body():
    found = swarm_at_once(motion(), 0, size=4)
    np.testing.assert_allclose(found.path[-1], TRUE, atol=1e-3)
    assert found.cost < 1e-4


def test_a_recursive_swarm_never_gets_worse_on_the_samples_so_far(data):
    path = swarm(data, 0).path
    for k in range(SAMPLES - len(path) + 2, SAMPLES + 1):
        before, after = path[k - SAMPLES - 2], path[k - SAMPLES - 1]
        costs = faded(data, np.array([before, after]), k)
        assert costs[1] <= costs[0] + 1e-12


def test_updates_are_the_recursions_that_changed_a_parameter():
    path = np.zeros((5, 8))
    path[2:, 3], path[4:, 7] = 1.0, -1.0
    path[:, 5] = np.nan  # of a method without it
    assert Run(path, 0.0, 0.0).updates == 2


def test_variances_are_those_of_the_last_parameters_over_the_runs():
    runs = [Run(np.full((2, 8), x), 0.0, 0.0) for x in (1.0, 3.0)]
    (row,) = variances_table({"no noise": {"one": runs}}).rows
    assert row[:2] == ("one, no noise", "0 of 1") and set(row[2:]) == {"2.0e+00"}
