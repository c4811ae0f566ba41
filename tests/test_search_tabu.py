"""The published search of kinematic calibration: ranked genetic, then tabu."""

import numpy as np
import pytest
from search import minimise
from search.ranked_genetic import RankedGenetic
from search.tabu import Tabu

from hybrid.errors import HybridError

LOW, HIGH = np.full(4, -2.0), np.full(4, 3.0)


def bowl(x):
    return np.linalg.norm(x - [0.5, -0.3, 1.0, 0.1], axis=1)


def test_the_genetic_search_comes_near_the_bottom():
    rng = np.random.default_rng(0)
    search = RankedGenetic(LOW, HIGH, rng=rng, generations=60)
    assert minimise(search, bowl, 60)[-1] < 0.2


def test_rings_shrink_with_the_value_so_that_tabu_converges():
    rng = np.random.default_rng(0)
    search = Tabu(LOW, HIGH, rng=rng, start=[2.0, -1.5, 1.0, 2.5])
    assert minimise(search, bowl, 1500)[-1] < 1e-6


def test_the_genetic_search_picks_at_random_first_and_the_fit_last():
    search = RankedGenetic(LOW, HIGH, rng=np.random.default_rng(0), population=10)
    search.tell(np.arange(10.0))
    np.testing.assert_allclose(search._chances(1.0), 0.1)
    last = search._chances(2.0)
    assert last.sum() == pytest.approx(1.0)
    assert set(np.argsort(last)[-2:]) == {
        0,
        9,
    }  # the fittest, and in place of the worst
    assert last.max() == pytest.approx(0.2)  # twice the mean
    assert last.min() == 0.0


def test_tabu_climbs_out_of_a_hollow_that_it_has_seen():
    # A shallow hollow at zero, where every step down ends, and a deep one beside it.
    def hollows(x):
        at = x[:, 0]
        return np.minimum(1.0 + 5.0 * np.abs(at), 0.05 + 5.0 * np.abs(at - 0.6))

    search = Tabu(
        [-1.0], [1.0], rng=np.random.default_rng(0), start=[0.0],
        radius=0.05, nearness=0.3,
    )  # fmt: skip
    minimise(search, hollows, 400)
    assert search.best.point[0] == pytest.approx(0.6, abs=0.01)


def test_what_is_forbidden_is_taken_only_if_it_is_the_best_of_all():
    def tabu():
        search = Tabu(
            LOW, HIGH, rng=np.random.default_rng(0), start=np.zeros(4), nearness=1e9
        )  # every point is near the one where it has been
        search.tell([1.0])
        return search, search.ask()

    search, x = tabu()
    search.tell(np.linspace(1.0, 2.0, len(x)))
    np.testing.assert_array_equal(search._here, np.zeros(4))
    search, x = tabu()
    search.tell(np.append(0.9, np.full(len(x) - 1, 2.0)))
    np.testing.assert_array_equal(search.best.point, x[0])
    np.testing.assert_array_equal(search._here, x[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rings": 0}, "valid are whole numbers from 1"),
        ({"start": [0.0]}, "start of shape"),
    ],
)
def test_tabu_refuses_nonsense(options, message):
    options = {"start": np.zeros(4), **options}
    with pytest.raises(HybridError, match=message):
        Tabu(LOW, HIGH, rng=np.random.default_rng(0), **options)
