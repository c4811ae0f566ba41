"""Population searches: they find known optima, within bounds, the same for one seed."""

import numpy as np
import pytest
from search import minimise
from search.adaptive_genetic import AdaptiveGenetic
from search.annealed_genetic import AnnealedGenetic
from search.niche_genetic import NicheGenetic
from search.particle_swarm import ParticleSwarm
from search.ranked_genetic import RankedGenetic
from search.recursive_differential_evolution import (
    RecursiveDifferentialEvolution,
)
from search.tabu import Tabu

from hybrid.errors import HybridError

LOWER, UPPER = np.array([-3.0, 0.0, 10.0]), np.array([5.0, 1.0, 90.0])
OPTIMUM = np.array([1.0, 0.3, 70.0])
KINDS = (AdaptiveGenetic, AnnealedGenetic, ParticleSwarm)
GENETIC = (AdaptiveGenetic, AnnealedGenetic, NicheGenetic, RankedGenetic)
EVERY = (*GENETIC, ParticleSwarm, Tabu)


def valley(x):
    """Zero at the optimum, curved, with ripples beside it."""
    u = (x - OPTIMUM) / (UPPER - LOWER)
    return (
        100 * (u[:, 0] - u[:, 1] ** 2) ** 2
        + (u**2).sum(1)
        + 0.1 * np.sin(20 * u[:, 2]) ** 2
    )


def search(kind, seed=0, **options):
    if kind is Tabu:
        options = {"start": [-2.0, 0.9, 20.0]}
    return kind(LOWER, UPPER, rng=np.random.default_rng(seed), **options)


@pytest.mark.parametrize("kind", KINDS)
def test_a_search_finds_the_optimum_among_ripples(kind):
    for seed in range(3):
        found = search(kind, seed)
        minimise(found, valley, 600)
        assert found.best.value < 2e-3
        np.testing.assert_allclose(
            (found.best.point - OPTIMUM) / (UPPER - LOWER), 0, atol=0.05
        )


@pytest.mark.parametrize("kind", EVERY)
def test_it_asks_within_the_bounds_and_never_loses_the_best(kind):
    found = search(kind, population=20)
    values, best = [], []
    for _ in range(60):
        x = found.ask()
        assert np.all(x >= LOWER) and np.all(x <= UPPER)
        assert len(x) == 20 or kind is Tabu
        values.append(valley(x).min())
        found.tell(valley(x))
        best.append(found.best.value)
    np.testing.assert_array_equal(best, np.minimum.accumulate(values))
    assert valley(found.best.point[None])[0] == found.best.value


@pytest.mark.parametrize("kind", EVERY)
def test_one_seed_gives_one_course(kind):
    courses = [minimise(search(kind, seed), valley, 40) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(courses[0], courses[1])
    assert np.any(courses[0] != courses[2])


@pytest.mark.parametrize("kind", KINDS)
def test_points_without_a_value_are_no_obstacle(kind):
    def holed(x):
        return np.where(x[:, 0] < 0, np.nan, valley(x))

    found = search(kind)
    minimise(found, holed, 300)
    assert np.isfinite(found.best.value) and found.best.point[0] >= 0
    empty = search(kind)
    minimise(empty, lambda x: np.full(len(x), np.nan), 4)
    assert np.all(empty.ask() >= LOWER)


def test_steps_uphill_and_long_ones_end_as_annealing_cools():
    hill = search(AnnealedGenetic, temperature=1.0, cooling=1e-9, chain=1)

    def annealed():
        hill.tell(valley(hill.ask()))  # the offspring
        x, before = hill._x.copy(), hill._values.copy()
        near = hill.ask()
        hill.tell(valley(near))
        distance = np.median(np.abs(near - x) / (UPPER - LOWER))
        return np.mean(hill._values > before), distance

    uphill, distance = zip(*(annealed() for _ in range(11)), strict=True)
    assert uphill[0] > 0.1 and uphill[10] == 0.0
    assert distance[10] < 1e-3 * distance[0]


def test_the_temperature_of_the_inner_loop_falls_by_the_cooling_in_ten_generations():
    found = search(AnnealedGenetic, temperature=0.5, cooling=0.9, chain=3)
    for generation in range(21):
        assert found.generation == generation
        assert found.temperature == pytest.approx(0.5 * 0.9 ** (generation / 10))
        for _ in range(1 + 3):  # the offspring, and three steps of annealing
            found.tell(valley(found.ask()))


def test_annealing_refuses_nonsense():
    with pytest.raises(HybridError, match="are a temperature above 0"):
        search(AnnealedGenetic, chain=0)


def test_mutations_shrink_to_nothing_with_the_last_generation():
    x = np.tile(OPTIMUM, (1000, 1))
    sizes = []
    for generation in (0, 250, 490, 500):
        found = search(AdaptiveGenetic, generations=500)
        found.generation = generation
        sizes.append(np.abs(found._mutate(x) - x).mean())
    assert sizes[0] > sizes[1] > sizes[2] > sizes[3] == 0.0


def test_the_fittest_are_changed_least():
    fitness = np.linspace(0, 1, 11)
    rates = AdaptiveGenetic._rate(fitness, fitness, (0.9, 0.6))
    assert np.all(rates[:6] == 0.9)
    assert np.all(np.diff(rates[5:]) < 0) and rates[-1] == pytest.approx(0.6)


# --- particle swarm -----------------------------------------------------------------


def test_inertia_falls_from_the_first_to_the_last_iteration_and_stays():
    shares = []
    for iteration in (1, 50, 100, 150):
        swarm = search(ParticleSwarm, iterations=100, cognitive=0.0, social=0.0)
        swarm._x[:], swarm._v[:] = OPTIMUM, 0.01
        swarm.iteration = iteration
        shares.append((swarm.ask()[0] - OPTIMUM) / 0.01)
    expected = np.outer([0.895, 0.65, 0.4, 0.4], np.ones(3))
    np.testing.assert_allclose(shares, expected, rtol=1e-9)


@pytest.mark.parametrize("pull", ["cognitive", "social"])
def test_particles_are_pulled_to_their_own_best_or_to_the_best_of_all(pull):
    swarm = ParticleSwarm(
        [-1], [1], rng=np.random.default_rng(0), population=2,
        **{"cognitive": 0.0, "social": 0.0, pull: 2.0},
    )  # fmt: skip
    swarm._x[:] = [[0.0], [0.8]]
    swarm.tell([0.0, 1.0])
    swarm._x[:] = [[0.5], [0.5]]
    first, second = swarm.ask()[:, 0] - 0.5
    assert first < 0
    assert second < 0 if pull == "social" else second > 0


def test_no_particle_is_faster_than_allowed():
    swarm = search(ParticleSwarm, fastest=0.1, social=50.0)
    swarm.tell(valley(swarm.ask()))
    before = swarm._x.copy()
    step = np.abs(swarm.ask() - before) / (UPPER - LOWER)
    assert 0.09 < step.max() <= 0.1 + 1e-12


def test_a_new_criterion_revalues_what_the_swarm_remembers():
    swarm = search(ParticleSwarm)
    minimise(swarm, valley, 50)
    swarm.renew(-valley(swarm.remembered))
    k = np.argmax(valley(swarm.remembered))
    np.testing.assert_array_equal(swarm.best.point, swarm.remembered[k])


def test_a_swarm_refuses_nonsense():
    with pytest.raises(HybridError, match="two particles or more"):
        search(ParticleSwarm, population=1)


# --- recursive differential evolution -----------------------------------------------


def line_data(samples=60):
    rng = np.random.default_rng(3)
    H = rng.standard_normal((samples, 2))
    return H, H @ np.array([0.7, -0.4])


def recursive(seed=0, **options):
    rng = np.random.default_rng(seed)
    population = rng.uniform(-1, 1, (40, 2))
    return RecursiveDifferentialEvolution(
        [-1, -1], [1, 1], rng=rng, population=population, **options
    )


def test_with_the_step_of_recursive_least_squares_it_follows_a_line():
    H, y = line_data()
    search, R = recursive(), 1e-3 * np.eye(2)
    for k in range(1, len(y)):

        def cost(x, k=k):
            return np.sum((y[:k] - x @ H[:k].T) ** 2, axis=1)

        search.renew(cost(search.population))
        R += np.outer(H[k], H[k])
        search.aim(np.linalg.solve(R, H[k] * (y[k] - H[k] @ search.best.point)))
        before = search.best.value
        x = search.ask()
        assert np.all(np.abs(x) <= 1)
        search.tell(cost(x))
        assert search.best.value <= before
    np.testing.assert_allclose(search.best.point, [0.7, -0.4], atol=0.02)


def test_a_trial_goes_some_of_the_way_to_the_best_and_along_the_step():
    search, step = recursive(crossover=1.0, factor=0.5, combination=0.25), [0.1, -0.2]
    x = search.population = 0.4 * search.population  # far from the bounds
    search.renew(np.arange(40.0))
    search.aim(np.array(step))
    expected = x + 0.25 * (x[0] - x) + 0.5 * np.array(step)
    np.testing.assert_allclose(search.ask(), expected, atol=1e-12)


def test_a_detour_moves_what_has_met_in_the_best_point():
    for detour, moves in ((0.0, False), (1.0, True)):
        search = recursive(detour=detour)
        search.population[2:] = search.population[0]
        search.aim(np.zeros(2))
        search.renew(np.array([0.0, 0.1] + 38 * [0.5]))
        trial = search.ask()[5]
        assert np.any(trial != search.population[0]) == moves


@pytest.mark.parametrize("lower, upper", [([0], [0]), ([0, 1], [1]), ([0], [np.inf])])
def test_bounds_that_are_none_are_refused(lower, upper):
    with pytest.raises(HybridError, match="bounds"):
        AdaptiveGenetic(lower, upper, rng=np.random.default_rng(0))


def test_values_of_another_number_are_refused():
    found = search(AdaptiveGenetic, population=10)
    found.ask()
    with pytest.raises(HybridError, match=r"valid is \(10,\)"):
        found.tell(np.zeros(9))


@pytest.mark.parametrize("kind", GENETIC)
def test_a_genetic_search_refuses_an_odd_population(kind):
    with pytest.raises(HybridError, match="an even number from 4"):
        search(kind, population=7)
