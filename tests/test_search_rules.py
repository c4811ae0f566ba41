"""What each search does in one step, against the rule of its source."""

import numpy as np
import pytest
from search import minimise
from search.adaptive_genetic import AdaptiveGenetic
from search.annealed_genetic import AnnealedGenetic
from search.niche_genetic import NicheGenetic
from search.ranked_genetic import RankedGenetic
from search.recursive_differential_evolution import (
    RecursiveDifferentialEvolution,
)
from search.search import checked_bounds, checked_values
from search.tabu import Tabu

from hybrid.errors import HybridError

LOW, HIGH = np.array([-3.0, 0.0, 10.0]), np.array([5.0, 1.0, 90.0])
GENETIC = (AdaptiveGenetic, AnnealedGenetic, NicheGenetic, RankedGenetic)


def rng(seed=0):
    return np.random.default_rng(seed)


def sphere(x):
    return (((x - LOW) / (HIGH - LOW) - 0.4) ** 2).sum(axis=1)


# --- recursive differential evolution -------------------------------------------------


def recursive(population, **options):
    return RecursiveDifferentialEvolution(
        [-10, -10], [10, 10], rng=rng(), population=population, **options
    )


def test_a_trial_is_the_individual_drawn_to_the_best_and_moved_by_the_step():
    x = np.array([[1.0, 2.0], [3.0, -1.0], [-2.0, 0.5]])
    search = recursive(x, factor=1.5, crossover=1.0, combination=0.25)
    search.renew(np.array([2.0, 1.0, 3.0]))
    search.aim(np.array([0.4, -0.6]))
    expected = x + 0.25 * (x[1] - x) + 1.5 * np.array([0.4, -0.6])
    np.testing.assert_allclose(search.ask(), expected, rtol=1e-14)


def test_without_crossover_one_coordinate_of_each_trial_is_new():
    x = np.zeros((50, 2))
    search = recursive(x, crossover=0.0)
    search.aim(np.ones(2))
    assert ((search.ask() != x).sum(axis=1) == 1).all()


def test_the_chance_of_crossing_is_the_one_given():
    x = np.zeros((4000, 2))
    search = recursive(x, crossover=0.5)
    search.aim(np.ones(2))
    # One of two coordinates is new by force, the other with the chance of a half.
    assert np.mean(search.ask() != x) == pytest.approx(0.75, abs=0.03)


def test_a_step_counts_as_vanished_below_a_hundredth_of_the_range():
    x = np.array([[0.0, 0.0], [1.0, 1.0], [5.0, 5.0]])
    for step, goal in ((0.19, x[1]), (0.21, x[0])):
        search = recursive(x, crossover=1.0, combination=1.0, factor=0.0, detour=1.0)
        search.renew(np.array([0.0, 1.0, 2.0]))
        search.aim(np.array([step, 0.0]))
        np.testing.assert_array_equal(search.ask()[2], goal)


def test_a_trial_that_is_as_good_takes_the_place_and_a_worse_one_does_not():
    x = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    search = recursive(x, crossover=1.0, combination=0.0, factor=1.0)
    search.renew(np.array([1.0, 1.0, 1.0]))
    search.aim(np.ones(2))
    search.ask()
    search.tell(np.array([1.0, 1.1, 0.9]))
    np.testing.assert_array_equal(search.population, [[2, 2], [2, 2], [4, 4]])
    assert search.best.value == 0.9
    np.testing.assert_array_equal(search.best.point, [4, 4])


def test_trials_stay_within_the_bounds_and_individuals_start_there():
    search = recursive([[99.0, 0.0], [0.0, -99.0]], crossover=1.0)
    np.testing.assert_array_equal(search.population, [[10, 0], [0, -10]])
    search.aim(np.array([50.0, -50.0]))
    np.testing.assert_array_equal(search.ask(), [[10, -10]] * 2)


@pytest.mark.parametrize("population", [[[0.0, 0.0]], [0.0, 0.0]])
def test_a_population_of_one_is_refused_and_two_are_enough(population):
    with pytest.raises(HybridError, match="two individuals"):
        recursive(population)
    assert len(recursive([[0.0, 0.0], [1.0, 1.0]]).population) == 2


@pytest.mark.parametrize("detour", [-0.1, 1.1])
def test_a_detour_is_a_probability(detour):
    with pytest.raises(HybridError, match="detour of 0 to 1"):
        recursive([[0.0, 0.0], [1.0, 1.0]], detour=detour)


# --- annealing ------------------------------------------------------------------------


def annealed(**options):
    return AnnealedGenetic(LOW, HIGH, rng=rng(), **options)


def test_by_itself_the_temperature_is_a_thousandth_and_falls_as_published():
    search = annealed(population=10)
    minimise(search, sphere, 11 * 200)  # the offspring, and ten steps of annealing
    assert search.generation == 200
    assert search.temperature == pytest.approx(0.001 * 0.99 ** (200 / 10))


@pytest.mark.parametrize("rise", [0.2, 1.0, 2.0])
def test_a_worse_neighbour_is_kept_as_often_as_metropolis_says(rise):
    size, spread = 4000, 8.0
    search = annealed(population=size, temperature=0.25)
    values = np.linspace(0.0, spread, size)
    search.tell(values[rng(1).permutation(size)] + 0 * sphere(search.ask()))
    before = search._values.copy()
    search.ask()
    worse = before + rise * 0.25 * spread
    search.tell(worse)
    kept = np.mean(search._values == worse)
    assert kept == pytest.approx(np.exp(-rise), abs=0.03)


def test_a_better_neighbour_is_always_kept():
    search = annealed(population=40, temperature=1e-6)
    search.tell(sphere(search.ask()) + 10.0)
    neighbours = search.ask()
    search.tell(np.arange(40.0) / 8)
    # But for the worst, whose place the best of all takes.
    np.testing.assert_array_equal(search._x[:39], neighbours[:39])
    np.testing.assert_array_equal(search._x[39], neighbours[0])


def test_neighbours_are_as_far_as_very_fast_annealing_draws_them():
    """For u in (−1, 1): step = sign(u) T ((1 + 1/T)^|u| − 1), of the bounds' width."""
    u, again = rng(5).random((2, 60_000))
    for T in (0.01, 0.3):
        search = annealed(population=20_000, temperature=T)
        middle = np.tile((LOW + HIGH) / 2, (20_000, 1))
        size = (search._neighbours(middle) - middle) / (HIGH - LOW)
        assert np.mean(size > 0) == pytest.approx(0.5, abs=0.02)
        step = T * ((1 + 1 / T) ** u - 1)
        step = np.where(step > 0.5, 0.5 * again, step)  # beyond the bound: before it
        shares = [0.25, 0.5, 0.75]
        found, expected = (np.quantile(np.abs(x), shares) for x in (size, step))
        np.testing.assert_allclose(found, expected, rtol=0.05)


def test_what_would_leave_the_bounds_lands_between_its_start_and_the_bound():
    search = annealed(population=4000, temperature=10.0)
    start = np.tile(LOW + 0.01 * (HIGH - LOW), (4000, 1))
    moved = (search._neighbours(start) - LOW) / (HIGH - LOW)
    assert (moved >= 0).all() and (moved <= 1).all()
    below = moved < 0.01
    assert np.mean(below) == pytest.approx(0.5, abs=0.03)
    assert np.mean(moved[below]) == pytest.approx(0.005, rel=0.05)


# --- tabu -----------------------------------------------------------------------------


def tabu(start=(0.0, 0.0), **options):
    return Tabu([-10, -10], [10, 10], rng=rng(), start=start, **options)


def test_a_forbidden_neighbour_that_is_best_of_all_is_taken_all_the_same():
    """Aspiration; with a nearness beyond every ring, all neighbours are forbidden."""
    search = tabu(nearness=2.0)
    search.tell(np.array([5.0]) + 0 * search.ask()[:, 0])
    x = search.ask()
    values = np.full(len(x), 6.0)
    values[7] = 4.0
    search.tell(values)
    np.testing.assert_array_equal(search._here, x[7])
    assert search.best.value == 4.0
    np.testing.assert_array_equal(search.best.point, x[7])


def test_a_forbidden_neighbour_that_is_not_best_of_all_is_passed_over():
    search = tabu(nearness=2.0)
    search.tell(np.array([5.0]) + 0 * search.ask()[:, 0])
    search.tell(np.full(len(search.ask()), 5.0))
    np.testing.assert_array_equal(search._here, [0.0, 0.0])


def test_an_allowed_neighbour_is_taken_though_it_is_worse():
    search = tabu(nearness=1e-9)
    search.tell(np.array([5.0]) + 0 * search.ask()[:, 0])
    x = search.ask()
    values = np.linspace(9.0, 6.0, len(x))
    search.tell(values)
    np.testing.assert_array_equal(search._here, x[-1])
    assert search.best.value == 5.0


@pytest.mark.parametrize("tenure, allowed", [(2, True), (3, False)])
def test_a_point_is_avoided_for_its_tenure_and_no_longer(tenure, allowed):
    search = tabu(tenure=tenure, nearness=1e-3)
    search.tell(np.array([1.0]) + 0 * search.ask()[:, 0])
    for _ in range(2):
        search.tell(np.full(len(search.ask()), 2.0))
    assert search._step == 3
    assert search._is_allowed(np.zeros((1, 2)))[0] == allowed


def test_the_oldest_points_are_forgotten_first():
    search = tabu(memory=2, nearness=1e-3)
    search.tell(np.array([1.0]) + 0 * search.ask()[:, 0])
    assert not search._is_allowed(np.zeros((1, 2)))[0]
    for _ in range(2):
        search.tell(np.full(len(search.ask()), 2.0))
    assert search._is_allowed(np.zeros((1, 2)))[0]


def test_a_point_is_near_where_all_its_coordinates_are():
    search = tabu(radius=0.05, nearness=0.5)  # the widest ring is 1, nearness 0.5
    search.tell(np.array([1.0]) + 0 * search.ask()[:, 0])
    x = np.array([[0.49, 0.49], [0.51, 0.0], [0.0, -0.51], [0.51, 0.51]])
    np.testing.assert_array_equal(search._is_allowed(x), [False, True, True, True])


def test_each_ring_is_half_as_wide_as_the_next_and_holds_its_points():
    search = tabu(rings=3, points=500, radius=0.1)
    search.tell(np.array([1.0]) + 0 * search.ask()[:, 0])
    size = np.abs(search.ask()).max(axis=1).reshape(3, 500) / 2.0
    for ring, (low, high) in zip(size, [(0, 0.25), (0.25, 0.5), (0.5, 1)], strict=True):
        assert ring.min() >= low and ring.max() <= high
        assert np.ptp(ring) > 0.9 * (high - low)
    other = np.abs(search.ask()).min(axis=1).reshape(3, 500) / 2.0
    assert (np.median(other, axis=1) < [0.15, 0.3, 0.6]).all()


def test_points_lie_on_all_four_sides_of_the_start():
    search = tabu(start=(1.0, -2.0), points=100)
    search.tell(np.array([1.0]) + 0 * search.ask()[:, 0])
    off = search.ask() - [1.0, -2.0]
    for sign in ([1, 1], [1, -1], [-1, 1], [-1, -1]):
        assert np.mean((np.sign(off) == sign).all(axis=1)) == pytest.approx(
            0.25, abs=0.08
        )


def test_rings_are_as_wide_as_the_value_is_small():
    search = tabu(nearness=1e-9, radius=0.1)
    search.tell(np.array([8.0]) + 0 * search.ask()[:, 0])
    np.testing.assert_allclose(search._width(), 2.0)
    search.tell(np.full(len(search.ask()), 2.0))
    np.testing.assert_allclose(search._width(), 0.5)
    search.tell(np.full(len(search.ask()), 99.0))
    np.testing.assert_allclose(search._width(), 2.0)


@pytest.mark.parametrize(
    "options", [{"rings": 0}, {"points": 0}, {"memory": 0}, {"tenure": 0}]
    + [{"radius": 0.0}, {"radius": -1.0}]
)  # fmt: skip
def test_a_search_without_neighbours_or_memory_is_refused(options):
    with pytest.raises(HybridError, match="valid are whole numbers from 1"):
        tabu(**options)
    least = {"rings": 1, "points": 1, "memory": 1, "tenure": 1}
    assert len(tabu(**least).ask()) == 1


# --- genetic searches -----------------------------------------------------------------


@pytest.mark.parametrize("kind", GENETIC)
def test_the_first_population_is_spread_over_the_bounds(kind):
    x = kind(LOW, HIGH, rng=rng(), population=400).ask()
    unit = (x - LOW) / (HIGH - LOW)
    np.testing.assert_allclose(unit.mean(axis=0), 0.5, atol=0.06)
    assert unit.min() < 0.02 and unit.max() > 0.98


@pytest.mark.parametrize("kind", GENETIC)
def test_the_default_search_gets_nearer_than_as_many_random_points(kind):
    for seed in range(3):
        search = kind(LOW, HIGH, rng=rng(seed))
        steps = 60
        minimise(search, sphere, steps)
        drawn = rng(seed).uniform(LOW, HIGH, (steps * search.population, 3))
        assert search.best.value < 0.5 * sphere(drawn).min()


@pytest.mark.parametrize("kind", (AdaptiveGenetic, AnnealedGenetic, RankedGenetic))
def test_the_best_of_all_takes_the_place_of_the_worst(kind):
    search = kind(LOW, HIGH, rng=rng(), population=6)
    first = search.ask()
    search.tell(np.array([3.0, 1.0, 2.0, 9.0, 4.0, 5.0]))
    np.testing.assert_array_equal(search._x[3], first[1])
    np.testing.assert_array_equal(search._values, [3, 1, 2, 1, 4, 5])
    np.testing.assert_array_equal(search._x[[0, 1, 2, 4, 5]], first[[0, 1, 2, 4, 5]])


@pytest.mark.parametrize("kind", GENETIC)
def test_without_mutation_offspring_lie_between_their_parents(kind):
    none = 0.0 if kind is NicheGenetic else (0.0, 0.0)
    search = kind(LOW, HIGH, rng=rng(), population=40, mutation=none)
    first = search.ask()
    search.tell(sphere(first))
    if kind is AnnealedGenetic:
        for _ in range(10):
            search.tell(np.full(40, np.inf))  # no neighbour is kept
    parents = search._x.copy()
    children = search.ask()
    assert (children >= parents.min(axis=0) - 1e-12).all()
    assert (children <= parents.max(axis=0) + 1e-12).all()
    assert (children[:, None] == parents).all(axis=2).any(axis=1).mean() < 0.9


def test_pairs_that_are_crossed_share_out_their_sum():
    search = NicheGenetic(
        LOW, HIGH, rng=rng(), population=40, crossover=1.0, mutation=0
    )
    search.tell(sphere(search.ask()))
    parents, children = search._x.copy(), search.ask()
    sums = children[:20] + children[20:]
    pairs = (parents[:, None] + parents).reshape(-1, 3)
    for total in sums:
        assert np.abs(pairs - total).max(axis=1).min() < 1e-9
    # A child differs from both parents: the share is drawn between them.
    assert not (children[:, None] == parents).all(axis=2).any(axis=1).all()


@pytest.mark.parametrize("kind", (NicheGenetic, AdaptiveGenetic, RankedGenetic))
def test_without_crossover_and_mutation_offspring_are_parents(kind):
    none = 0.0 if kind is NicheGenetic else (0.0, 0.0)
    crossover = (0.0, 0.0) if kind is AdaptiveGenetic else 0.0
    options = {"crossover": crossover, "mutation": none}
    search = kind(LOW, HIGH, rng=rng(), population=40, **options)
    search.tell(sphere(search.ask()))
    parents, children = search._x.copy(), search.ask()
    assert (children[:, None] == parents).all(axis=2).any(axis=1).all()


@pytest.mark.parametrize("kind", (NicheGenetic, AdaptiveGenetic))
def test_the_fit_have_more_offspring(kind):
    none = 0.0 if kind is NicheGenetic else (0.0, 0.0)
    crossover = (0.0, 0.0) if kind is AdaptiveGenetic else 0.0
    options = {"crossover": crossover, "mutation": none}
    search = kind(LOW, HIGH, rng=rng(), population=400, **options)
    search.tell(sphere(search.ask()))
    assert sphere(search.ask()).mean() < 0.9 * np.mean(search._values)


def test_mutated_coordinates_are_as_many_as_asked_for_and_drawn_over_the_range():
    search = NicheGenetic(
        LOW, HIGH, rng=rng(), population=2000, crossover=0, mutation=0.25, niche=0
    )
    search.tell(sphere(search.ask()))
    known = np.sort(search._x, axis=0)
    children = search.ask()
    new = np.array([~np.isin(children[:, j], known[:, j]) for j in range(3)])
    assert np.mean(new) == pytest.approx(0.25, abs=0.03)
    unit = ((children - LOW) / (HIGH - LOW)).T[new]
    assert np.mean(unit) == pytest.approx(0.5, abs=0.04)


def test_of_two_that_crowd_the_better_survives():
    search = NicheGenetic(np.zeros(2), np.ones(2), rng=rng(), population=4, niche=0.1)
    x = np.array([[0.5, 0.5], [0.9, 0.1], [0.5, 0.55], [0.1, 0.9]])
    # The distance is measured in parts of the diagonal: 0.1 · √2 here.
    np.testing.assert_array_equal(search._crowded(x), [False, False, True, False])
    near = np.array([[0.5, 0.5], [0.5, 0.65]])
    np.testing.assert_array_equal(search._crowded(near), [False, False])
    near = np.array([[0.5, 0.5], [0.5, 0.63]])
    np.testing.assert_array_equal(search._crowded(near), [False, True])


def test_offspring_compete_with_the_better_half_of_their_parents():
    search = NicheGenetic(LOW, HIGH, rng=rng(), population=6, niche=0)
    first = search.ask()
    search.tell(np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    second = search.ask()
    search.tell(np.array([0.5, 9.0, 9.1, 2.5, 9.3, 9.4]))
    np.testing.assert_array_equal(search._values, [0.5, 1.0, 2.0, 2.5, 3.0, 9.0])
    np.testing.assert_array_equal(search._x[0], second[0])
    np.testing.assert_array_equal(search._x[4], first[2])


def test_roulette_goes_by_the_inverse_of_the_value():
    search = NicheGenetic(LOW, HIGH, rng=rng(), population=4)
    search.tell(np.array([1.0, 2.0, 4.0, np.inf]))
    np.testing.assert_allclose(search._chances(), np.array([4, 2, 1, 0]) / 7)
    below = NicheGenetic(LOW, HIGH, rng=rng(), population=4)
    below.tell(np.array([-3.0, -2.0, 0.0, np.inf]))  # shifted until the least is one
    np.testing.assert_allclose(below._chances(), np.array([4, 2, 1, 0]) / 7)
    none = NicheGenetic(LOW, HIGH, rng=rng(), population=4)
    none.tell(np.full(4, np.nan))
    np.testing.assert_allclose(none._chances(), 0.25)


@pytest.mark.parametrize(
    "options",
    [{"population": 2}, {"population": 5}, {"crossover": 1.1}, {"crossover": -0.1}]
    + [{"mutation": 1.1}, {"mutation": -0.1}, {"niche": -0.1}],
)
def test_rates_of_niches_are_probabilities(options):
    with pytest.raises(HybridError, match="an even population from 4"):
        NicheGenetic(LOW, HIGH, rng=rng(), **options)
    for rates in ({"crossover": 0, "mutation": 1}, {"crossover": 1, "mutation": 0}):
        NicheGenetic(LOW, HIGH, rng=rng(), population=4, niche=0, **rates)


def test_fitness_is_how_far_a_value_is_below_the_worst():
    search = AdaptiveGenetic(LOW, HIGH, rng=rng(), population=4)
    search._values = np.array([0.0, 1.0, 4.0, np.inf])
    np.testing.assert_allclose(search._fitness(), [1.0, 0.75, 0.0, 0.0], atol=2e-6)
    assert (search._fitness() > 0).all()
    search._values = np.full(4, 3.0)
    np.testing.assert_array_equal(search._fitness(), 1.0)


@pytest.mark.parametrize("kind", (AdaptiveGenetic, RankedGenetic))
def test_the_rates_of_the_schedule_are_those_given(kind):
    search = kind(LOW, HIGH, rng=rng(), population=4000, generations=10)
    search.tell(np.zeros(4000))  # all alike: nobody is fitter than the average
    known = [np.unique(search._x[:, j]) for j in range(3)]
    children = search.ask()
    old = np.array([np.isin(children[:, j], known[j]) for j in range(3)])
    crossed = 1.0 - old.all(axis=0).mean()
    rate, chance = (0.9, 0.1) if kind is AdaptiveGenetic else (0.95 * 0.9**2, 0.185)
    expected = 1.0 - (1.0 - rate) * (1.0 - chance) ** 3
    assert crossed == pytest.approx(expected, abs=0.03)


def test_ranked_mutations_shrink_with_the_square_of_what_is_left():
    """The step is 1 − u^((1 − i/G)²) of the way to a bound."""
    for done in (0.0, 0.5):
        search = RankedGenetic(
            LOW, HIGH, rng=rng(), population=4000, generations=10,
            crossover=0.0, mutation=(1.0, 1.0),
        )  # fmt: skip
        search.tell(np.zeros(4000))
        search._x[:] = middle = (LOW + HIGH) / 2
        search.generation = max(1e-9, 10 * done)
        way = np.abs(search.ask() - middle) / (HIGH - LOW) * 2
        power = (1.0 - done) ** 2
        assert way.mean() == pytest.approx(1 - 1 / (1 + power), rel=0.03)


def test_bounds_and_values_are_checked():
    low, high = checked_bounds([0, 1], [1, 2])
    assert low.tolist() == [0.0, 1.0] and high.tolist() == [1.0, 2.0]
    for bad in (([[0]], [[1]]), ([0], [1, 2]), ([1, 0], [0, 1]), ([-np.inf], [0])):
        with pytest.raises(HybridError, match="bounds"):
            checked_bounds(*bad)
    np.testing.assert_array_equal(checked_values([1, np.nan], 2), [1.0, np.inf])
