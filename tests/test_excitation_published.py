"""The two designs of the literature, on small cases."""

from dataclasses import replace

import numpy as np
import pytest
from arms import MODELS
from excitation_published import (
    BlockCondition,
    BlockProgram,
    PopulationProgram,
    gravity_columns,
    iterated_design,
    niche_design,
    set_condition,
)
from search.niche_genetic import NicheGenetic
from search.search import minimise
from series import FourierQuintic

from hybrid.effects import effects_from_text
from hybrid.excitation import (
    Condition,
    Fourier,
    observe,
)
from hybrid.excitation.constraints import Limits, MotionLimits
from hybrid.excitation.path import uniform
from hybrid.excitation.program import MotionProgram
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

PLANAR = Robot.load(MODELS / "planar.xml")


def ripples(x):
    """Many valleys, the deepest at 0.3 in every coordinate."""
    y = x - 0.3
    return (y**2 - 0.3 * np.cos(6 * np.pi * y) + 0.3).sum(axis=1)


def test_the_niche_algorithm_finds_the_deepest_of_many_valleys():
    best = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        search = NicheGenetic([-2, -2, -2], [2, 2, 2], rng=rng)
        history = minimise(search, ripples, 150)
        assert (np.diff(history) <= 0).all()
        best.append(search.best.value)
    assert np.median(best) < 0.05


def test_niches_keep_the_population_apart():
    spread = []
    for niche in (0.0, 0.05):
        rng = np.random.default_rng(0)
        search = NicheGenetic([-2, -2], [2, 2], rng=rng, mutation=0.02, niche=niche)
        # Never below 1, as a condition number; near 0 the roulette sees one only.
        minimise(search, lambda x: 1 + (x**2).sum(axis=1), 60)
        spread.append(search.ask().std())
    assert spread[1] > 2 * spread[0]


def program(criterion, observation, kind=MotionProgram, **options):
    limits = Limits.of(PLANAR)
    b = observation.size + (kind is BlockProgram)
    return kind(
        observation,
        criterion,
        Fourier(3, 0.2),
        (MotionLimits(limits, PLANAR.joints),),
        limits,
        np.zeros((b, b)),
        20.0,
        1.0,
        1e-3,
        **options,
    )


@pytest.mark.study
@pytest.mark.parametrize("weighted", [False, True])
def test_iterated_designs_improve_with_each_motion_and_keep_the_limits(weighted):
    observation = observe(PLANAR.chain, covariance=np.diag([4.0, 1.0]))
    start = program(Condition(), observation)
    if weighted:
        criterion = BlockCondition(gravity_columns(observation))
        start = program(criterion, observation, BlockProgram)
    found = iterated_design(
        start,
        trajectories=2,
        rng=np.random.default_rng(0),
        tries=3,
    )
    pair, first = (set_condition(observation, x, 20.0) for x in (found, found[:1]))
    assert pair < 1.02 * first
    limits = Limits.of(PLANAR)
    for motion in found:
        path = motion.path(uniform(5.0, 200.0))
        assert (np.abs(path.v) <= 1.001 * limits.speed).all()
        assert (path.q <= limits.high + 1e-3).all()


def test_gravity_columns_are_those_that_a_resting_arm_feels():
    observation = observe(PLANAR.chain)
    names = np.array(observation.base.kept_labels)
    felt = names[gravity_columns(observation)]
    assert len(felt) and all(x[0] == "m" for x in felt)
    assert all(x[0] == "I" for x in names[~gravity_columns(observation)])


def test_the_population_design_keeps_limits_and_beats_its_first_population():
    scara = Robot.load(MODELS / "scara.xml")
    unknown = effects_from_text("viscous,coulomb", scara.joints, joint_scales(scara))
    observation = observe(scara.chain, unknown)
    limits = Limits.of(scara)
    search = PopulationProgram(
        observation, Condition(), FourierQuintic(5, 0.1), limits, 10.0, 10.0
    )
    rng = np.random.default_rng(0)
    motion = niche_design(search, rng=rng, generations=40)
    upper = search.bounds.ravel()
    first = search.values(rng.uniform(-upper, upper, (50, len(upper))))
    value = search.values(motion.coefficients.reshape(1, -1))[0]
    assert value < first.min()
    path = replace(motion, family=FourierQuintic(5, 0.1)).path(uniform(10.0, 10.0))
    assert (np.abs(path.v) <= 1.01 * limits.speed).all()


@pytest.mark.parametrize("signed", [False, True])
def test_the_block_condition_weighs_by_std_over_mean_of_the_entries(signed):
    observation = observe(PLANAR.chain, covariance=np.diag([4.0, 1.0]))
    gravity = gravity_columns(observation)
    start = program(BlockCondition(gravity), observation, BlockProgram, signed=signed)
    x = start.random(np.random.default_rng(3))
    path = start.grid.path(start.coefficients(x)).at(slice(0, 70))  # moves on average
    H = observation.matrix(path).reshape(-1, observation.size)
    mean = H.mean(axis=0) if signed else np.abs(H).mean(axis=0)
    weight = np.sqrt((H**2).mean(axis=0) - mean**2) / np.abs(mean)
    first, second = weight[gravity].mean(), weight[~gravity].mean()
    expected = (first + second) * np.linalg.cond(H)
    expected += first * np.linalg.cond(H[:, gravity])
    expected += second * np.linalg.cond(H[:, ~gravity])
    gram = start._bordered(observation.matrix(path))
    assert start.criterion.value(gram) == pytest.approx(expected)


def test_the_block_condition_has_exact_slopes():
    observation = observe(PLANAR.chain, covariance=np.diag([4.0, 1.0]))
    criterion = BlockCondition(gravity_columns(observation))
    start = program(criterion, observation, BlockProgram)
    x = start.random(np.random.default_rng(3))
    along = np.random.default_rng(4).normal(size=x.shape)
    ends = [start.objective(x + step * along)[0] for step in (1e-7, -1e-7)]
    slope = start.objective(x)[1] @ along
    assert (ends[0] - ends[1]) / 2e-7 == pytest.approx(slope, rel=1e-3)


def test_as_printed_an_acceleration_between_rests_has_no_mean_to_divide_by():
    observation = observe(PLANAR.chain)
    start = program(Condition(), observation, BlockProgram, signed=True)
    gram = start.information(start.random(np.random.default_rng(3)))
    spread = np.sqrt(gram.diagonal()[:-1] / gram[-1, -1])
    mean = np.abs(gram[:-1, -1]) / gram[-1, -1] / spread
    assert mean.min() < 1e-9 < 1e-2 < mean.max()
