"""Designed motions: families, observation, criteria, solver, designs on disk."""

import csv
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import MODELS, public_arm, random_arm, random_states
from hypothesis import given, settings
from hypothesis import strategies as st
from series import FourierQuintic, PlainFourier

from hybrid.dynamics import regressor, regressor_gradient
from hybrid.dynamics.regressor import inverse_dynamics
from hybrid.effects import effect_class, effects_from_text
from hybrid.errors import ExcitationError
from hybrid.excitation import (
    Condition,
    DOptimal,
    Fourier,
    Limits,
    Spline,
    design,
    observe,
)
from hybrid.excitation.expected_error import ExpectedError
from hybrid.excitation.experiments import Walk
from hybrid.excitation.path import Grid, Trajectory, uniform
from hybrid.excitation.solver import solve
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot

FAMILIES = [
    Fourier(4, 0.1),
    FourierQuintic(3, 0.1),
    FourierQuintic(3, 0.2, 2),
    Spline(10.0, 7),
    PlainFourier(3, 0.1),
]
FRICTION = ("viscous", "coulomb", "armature", "torque_offset", "load_friction")


def scara() -> Robot:
    return Robot.load(MODELS / "scara.xml")


def friction(robot: Robot):
    names = ",".join(FRICTION[:2])
    return effects_from_text(names, robot.joints, joint_scales(robot))


@cache
def pair():
    return simple_design(trajectories=2)


@cache
def usual_design():
    return simple_design()


def simple_design(seed: int = 0, **options):
    robot = scara()
    observation = observe(robot.chain, friction(robot))
    rng = np.random.default_rng(seed)
    options = {"criterion": Condition(), "starts": 1} | options
    return design(robot, observation, Fourier(4, 0.1), seed=rng, **options)


@pytest.mark.parametrize("seed", range(4))
def test_the_regressor_gradient_is_that_of_finite_differences(seed):
    robot = random_arm(seed)
    n = robot.size
    states = random_states(n, 5)
    weight = np.random.default_rng(seed).normal(size=(5, n, 10 * n))
    found = regressor_gradient(robot.chain, *states, weight)
    for k in range(3):
        for j in range(n):
            ends = []
            for step in (1e-6, -1e-6):
                moved = [x.copy() for x in states]
                moved[k][:, j] += step
                ends.append((weight * regressor(robot.chain, *moved)).sum((1, 2)))
            expected = (ends[0] - ends[1]) / 2e-6
            size = max(1.0, np.abs(expected).max())
            np.testing.assert_allclose(found[k][:, j], expected, atol=1e-7 * size)


@pytest.mark.parametrize("family", FAMILIES, ids=lambda f: type(f).__name__)
def test_bases_are_derivatives_of_each_other(family):
    t = np.linspace(0.3, family.duration - 0.3, 38)  # not at a joint of periods
    step = 1e-4
    for k in range(3):
        change = family.basis(t + step, k) - family.basis(t - step, k)
        size = np.abs(family.basis(t, k + 1)).max()
        np.testing.assert_allclose(
            change / (2 * step), family.basis(t, k + 1), atol=1e-6 * size
        )


@pytest.mark.parametrize("family", FAMILIES[:4], ids=lambda f: type(f).__name__)
def test_motions_begin_and_end_at_rest(family):
    ends = np.array([0.0, family.duration])
    for k in (1, 2):
        assert np.abs(family.basis(ends, k)).max() < 1e-9


def gradient_error(observation, criterion, motion: Grid, x, power: float) -> float:
    def value(x):
        gram = observation.gram(motion.path(x))
        return criterion.smooth(gram, power)[0]

    W = observation.matrix(motion.path(x))
    rows = W.reshape(-1, observation.size)
    slope = criterion.smooth(rows.T @ rows, power)[1]
    by = observation.gradient(motion.path(x), 2 * W @ slope)
    along = np.random.default_rng(1).normal(size=x.shape)
    expected = (value(x + 1e-6 * along) - value(x - 1e-6 * along)) / 2e-6
    return abs((motion.gradient(*by) * along).sum() - expected) / abs(expected)


@pytest.mark.parametrize("kind", range(3))
def test_criteria_have_exact_gradients_through_regressor_and_friction(kind):
    robot = public_arm("ur10")
    effects = [effect_class(e)((j,)) for j in range(robot.size) for e in FRICTION]
    noise = np.diag([4.0, 4.0, 1.0, 0.1, 0.1, 0.1]) + 0.02
    observation = observe(robot.chain, effects, covariance=noise)
    family = Fourier(4, 0.1)
    x = 0.5 * np.random.default_rng(0).normal(size=(family.size, robot.size))
    motion = Grid(family, uniform(10.0, 10.0))
    expected = ExpectedError.of(robot, observation, [motion.path(0.7 * x)])
    observation = expected.observation if kind == 2 else observation
    criterion = (Condition(), DOptimal(), expected)[kind]
    assert gradient_error(observation, criterion, motion, x, 6.0) < 1e-5


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_smooth_measures_approach_the_measures(seed):
    W = np.random.default_rng(seed).normal(size=(40, 5))
    gram = W.T @ W
    sharp = np.exp(Condition().smooth(gram, 2000.0)[0])
    assert sharp == pytest.approx(Condition().value(gram), rel=2e-3)
    assert Condition().value(gram) == pytest.approx(np.linalg.cond(W), rel=1e-6)
    volume = np.linalg.det(gram) ** (-1 / 10)
    assert DOptimal().value(gram) == pytest.approx(volume)


def test_d_optimality_ranks_motions_the_same_whatever_the_units():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 30, 4))
    scale = np.diag([1.0, 1e3, 1e-2, 5.0])
    measure = DOptimal().value
    plain = measure(first.T @ first) / measure(second.T @ second)
    first, second = first @ scale, second @ scale
    scaled = measure(first.T @ first) / measure(second.T @ second)
    assert scaled == pytest.approx(plain)


class Rosenbrock:
    """Within a disc, its minimum at the edge."""

    def objective(self, x):
        a, b = 1 - x[0], x[1] - x[0] ** 2
        slope = np.array([-2 * a - 40 * x[0] * b, 20 * b])
        return a**2 + 10 * b**2, slope

    def conditions(self, x):
        return np.array([x @ x - 1.0]), 2 * x[None]

    def excess(self, x):
        return float(x @ x - 1.0)


@pytest.mark.parametrize("start", [(0.0, 0.0), (-0.8, 0.9), (2.0, 2.0)])
def test_the_solver_finds_a_constrained_minimum_from_anywhere(start):
    found = solve(Rosenbrock(), np.array(start), iterations=200)
    angle = np.linspace(0, 2 * np.pi, 20001)
    edge = np.stack([np.cos(angle), np.sin(angle)])
    values = (1 - edge[0]) ** 2 + 10 * (edge[1] - edge[0] ** 2) ** 2
    assert found.excess < 1e-5
    assert found.value == pytest.approx(values.min(), abs=1e-5)


def test_a_design_is_far_better_conditioned_than_random_motions():
    result = usual_design()
    robot, rng = result.robot, np.random.default_rng(1)
    limits = Limits.of(robot)
    random = []
    for _ in range(20):
        x = rng.normal(size=(result.trajectories[0].family.size, 2))
        path = Trajectory(result.trajectories[0].family, x).path(uniform(10.0, 20.0))
        fill = np.abs(path.v).max(axis=0) / limits.speed
        scaled = Trajectory(result.trajectories[0].family, x / fill)
        gram = result.observation.gram(scaled.path(path.t), turning_speed=0)
        random.append(Condition().value(gram))
    assert result.condition < 0.6 * np.median(random)
    assert result.condition < min(random)


def test_limits_hold_between_the_samples_too():
    result = usual_design()
    limits = Limits.of(result.robot)
    path = result.trajectories[0].path(uniform(10.0, 2777.0))
    assert (path.q <= limits.high).all() and (path.q >= limits.low).all()
    assert (np.abs(path.v) <= limits.speed).all()
    assert (np.abs(path.a) <= limits.acceleration).all()
    chain, robot = result.robot.chain, result.robot
    tau = inverse_dynamics(chain, chain.inertial, path.q, path.v, path.a)
    tau += chain.armature * path.a + robot.damping * path.v
    tau += robot.frictionloss * np.sign(path.v)
    assert (np.abs(tau) <= limits.torque).all()
    assert max(result.excess.values()) <= 0


def test_a_jerk_limit_is_kept():
    free = usual_design().trajectories[0].path(uniform(10.0, 500.0))
    result = simple_design(limits=Limits.of(scara(), jerk=3.0))
    path = result.trajectories[0].path(uniform(10.0, 500.0))
    assert np.abs(free.jerk).max(axis=0).min() > 4.0
    assert 2.9 < np.abs(path.jerk).max() <= 3.0


def test_the_same_seed_gives_the_same_motion():
    again = pair().trajectories[0].coefficients  # however many motions follow
    assert np.array_equal(usual_design().trajectories[0].coefficients, again)


def test_each_motion_of_a_set_adds_information():
    result = pair()
    sums = np.cumsum(result.grams, axis=0)
    conditions = [Condition().value(x) for x in sums]
    assert conditions == sorted(conditions, reverse=True)
    assert result.condition == pytest.approx(conditions[-1])
    assert (result.additions > 0).all() and result.additions[0] == 1.0


def test_predicted_standard_errors_are_those_of_repeated_fits():
    result = usual_design()
    observation, rng = result.observation, np.random.default_rng(0)
    path = result.trajectories[0].path(uniform(10.0, 20.0))
    W = observation.matrix(path, turning_speed=0).reshape(-1, observation.size)
    noise = rng.normal(size=(len(W), 4000))
    spread = (np.linalg.pinv(W) @ noise).std(axis=1)
    np.testing.assert_allclose(result.standard_errors(), spread, rtol=0.06)


def test_what_cannot_be_met_is_named():
    planar = Robot.load(MODELS / "planar.xml")
    observation = observe(planar.chain)
    weak = replace(Limits.of(planar), torque=np.array([1e-3, 1e3]))
    with pytest.raises(ExcitationError, match=f"torque of {planar.joints[0]}"):
        design(
            planar,
            observation,
            Fourier(3, 0.2),
            seed=np.random.default_rng(0),
            starts=1,
            limits=weak,
        )


class Apart:
    """The first joint above 0.3 rad and below −0.3 rad: each, but not both, can be."""

    is_linear, names = False, ("upper side", "lower side")

    def excess(self, path):
        return np.stack([0.3 - path.q[:, 0], path.q[:, 0] + 0.3], axis=1)

    def slope(self, path, which):
        out = np.zeros((len(which), 4, path.q.shape[1]))
        out[:, 0, 0] = np.where(which, 1.0, -1.0)
        return out


def test_conditions_that_exclude_each_other_end_with_the_best_motion_and_its_excess():
    planar = Robot.load(MODELS / "planar.xml")
    with pytest.raises(ExcitationError, match="(upper|lower) side by") as error:
        design(
            planar, observe(planar.chain), Fourier(2, 1.0), seed=0, starts=1,
            constraints=[Apart()], criterion=DOptimal(), rate=10.0,
        )  # fmt: skip
    assert "no motion within the limits was found" in str(error.value)


@pytest.mark.parametrize(
    "make, says",
    [
        (lambda: Fourier(1, 0.1), "order is 1"),
        (lambda: Fourier(3, -1.0), "fundamental is -1"),
        (lambda: Fourier(3, 0.1, 0), "periods is 0"),
        (lambda: Spline(0.0, 5), "length is 0"),
        (lambda: Spline(1.0, 2), "points is 2"),
        (lambda: Limits.of(scara(), fill=1.5), "fill is 1.5"),
        (lambda: Trajectory(Fourier(3, 0.1), np.ones((2, 2))), "shape"),
        (lambda: observe(scara().chain, covariance=-np.eye(2)), "positive"),
        (lambda: simple_design(trajectories=0), "1 or more"),
    ],
)
def test_bad_requests_say_what_is_valid(make, says):
    with pytest.raises(ExcitationError, match=says):
        make()


def test_a_design_on_disk_is_the_motion(tmp_path):
    result = pair()
    paths = result.save(tmp_path, rate=100.0)
    content = json.loads((tmp_path / "design.json").read_text())
    family = result.trajectories[0].family
    loaded = [
        Trajectory(family, np.array(x["coefficients"])) for x in content["trajectories"]
    ]
    assert content["condition"] == result.condition
    for path, motion in zip(paths, loaded, strict=True):
        with path.open() as file:
            header, *rows = csv.reader(file)
        assert header[:3] == ["t", "q_shoulder", "q_elbow"]
        table = np.array(rows, dtype=float)
        reference = motion.reference(100.0)
        np.testing.assert_allclose(table[:, 1:3], reference.q, atol=1e-9)
        np.testing.assert_allclose(table[:, 5:7], reference.a, rtol=1e-8, atol=1e-8)


# --- motions from knot to knot --------------------------------------------------------

STEP = st.tuples(st.sampled_from(["wait", "go", "move", "cruise"]), st.integers(0, 999))


def allowed(speed=2.0, acceleration=3.0):
    """Two joints of which the second is half as fast."""
    one = np.array([1.0, 0.5])
    free = np.full(2, np.inf)
    return Limits(-10 * one, 10 * one, speed * one, acceleration * one, free, free)


@settings(max_examples=40)
@given(steps=st.lists(STEP, min_size=1, max_size=6))
def test_a_walk_ends_at_rest_where_its_steps_lead_without_a_jump(steps):
    here = np.array([0.3, -0.2])
    walk = Walk(here)
    for kind, seed in steps:
        rng = np.random.default_rng(seed)
        goal, duration = here + rng.uniform(0.01, 1.0, 2), 0.6 + rng.random()
        if kind == "wait":
            walk.wait(duration)
            goal = here
        elif kind == "go":
            walk.go(goal, duration)
        elif kind == "cruise":
            walk.cruise(np.array([0.0, 0.5]), 0.25, duration)
            goal = here + [0.0, 0.5 * (duration + 0.25)]
        else:
            walk.move(goal, allowed())
        here = goal
    found = walk.reference(1000.0)
    np.testing.assert_allclose(found.q[0], [0.3, -0.2])
    np.testing.assert_allclose(found.q[-1], here, atol=1e-4)
    np.testing.assert_allclose(found.v[0], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.v[-1], 0.0, atol=0.1)
    for x, rate, off in ((found.q, found.v, 2e-3), (found.v, found.a, 0.5)):
        slope = (x[2:] - x[:-2]) / (found.t[2:] - found.t[:-2])[:, None]
        np.testing.assert_allclose(slope, rate[1:-1], atol=off)


def test_a_cruise_keeps_its_speed_between_two_ramps():
    walk = Walk(np.array([1.0, 2.0]))
    walk.wait(0.5)
    walk.cruise(np.array([0.0, -0.8]), 0.4, 1.0)
    found = walk.reference(100.0)
    assert found.t[-1] == pytest.approx(0.5 + 0.4 + 1.0 + 0.4)
    np.testing.assert_allclose(found.q[:, 0], 1.0)
    np.testing.assert_allclose(found.q[:50, 1], 2.0)
    np.testing.assert_allclose(found.v[91:190, 1], -0.8, rtol=1e-9)
    np.testing.assert_allclose(found.q[[90, 190], 1], [2.0 - 0.16, 2.0 - 0.96])
    assert found.q[-1, 1] == pytest.approx(2.0 - 0.8 * 1.4)
    assert np.abs(found.v[[0, -1]]).max() < 1e-12


@pytest.mark.parametrize(
    ("way", "speed", "acceleration", "tight"),
    [([4.0, 0.5], 2.0, 90.0, "v"), ([0.1, 2.0], 2.0, 90.0, "v"),
     ([4.0, 0.5], 90.0, 3.0, "a"), ([0.1, 2.0], 90.0, 3.0, "a")],
)  # fmt: skip
def test_a_move_takes_half_of_the_tightest_limit(way, speed, acceleration, tight):
    limits, walk = allowed(speed, acceleration), Walk(np.zeros(2))
    walk.move(np.array(way), limits)
    found = walk.reference(5000.0)
    most = {"v": limits.speed, "a": limits.usable_acceleration}
    share = {x: np.abs(getattr(found, x)).max(axis=0) / most[x] for x in most}
    assert share[tight].max() == pytest.approx(0.5, rel=1e-3)
    assert max(x.max() for x in share.values()) < 0.5001
    np.testing.assert_allclose(found.q[-1], way, atol=1e-9)


def test_a_move_to_where_the_arm_is_takes_no_time_and_a_tiny_one_a_tenth():
    walk, limits = Walk(np.zeros(2)), allowed()
    walk.move(np.full(2, 1e-14), limits)
    walk.move(np.full(2, 1e-7), limits)
    assert walk.reference(1000.0).t[-1] == pytest.approx(0.1)
