"""Steps of the solver, and starts, limits and postures of a motion that is designed."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.errors import ExcitationError
from hybrid.excitation import Condition, DOptimal, Fourier, Limits, Spline, observe
from hybrid.excitation.constraints import MotionLimits
from hybrid.excitation.design import _infeasible
from hybrid.excitation.path import Grid, Trajectory, quintic, uniform
from hybrid.excitation.program import MotionProgram
from hybrid.excitation.solver import _updated, solve

# --- solver ---------------------------------------------------------------------------


class Line:
    """A value that says it falls by one in each unit; what it does is another thing."""

    def __init__(self, value):
        self.value, self.seen = value, []

    def objective(self, x):
        self.seen.append(float(x[0]))
        return self.value(float(x[0])), np.array([-1.0])

    def conditions(self, x):
        return np.zeros(0), np.zeros((0, 1))

    def excess(self, x):
        return -1.0


def test_a_step_doubles_where_its_promise_is_kept_up_to_a_half():
    line = Line(lambda x: -x)
    found = solve(line, np.zeros(1), iterations=7)
    np.testing.assert_allclose(np.diff(line.seen), [0.1, 0.2, 0.4, *[0.5] * 4])
    assert found.x == pytest.approx(2.7) and found.value == pytest.approx(-2.7)


def test_where_no_step_helps_it_is_halved_down_to_a_hundred_thousandth():
    line = Line(abs)
    found = solve(line, np.zeros(1), iterations=70)
    tried = 0.1 * 0.5 ** np.arange(14)
    tried = tried[tried > 1e-5]
    np.testing.assert_allclose(line.seen[1:], tried, rtol=1e-3)
    assert found.x == 0.0


@pytest.mark.parametrize(
    ("share", "second"),
    [(0.04, 0.05), (0.06, 0.15), (0.24, 0.15), (0.26, 0.2), (0.69, 0.2), (0.71, 0.3)],
)
def test_a_step_is_taken_shortened_or_lengthened_by_the_share_of_its_promise(
    share, second
):
    """A step of 0.1 promises 0.1, less half of its square by the curvature of one."""
    line = Line(lambda x: -share * 0.95 * x)
    solve(line, np.zeros(1), iterations=2)
    np.testing.assert_allclose(line.seen, [0.0, 0.1, second], rtol=1e-6)


def test_the_curvature_is_that_of_the_last_step_and_stays_positive():
    B = np.array([[2.0, 0.5], [0.5, 1.0]])
    step = np.array([0.3, -0.1])
    curve = step @ B @ step
    change = np.array([0.9, 0.2])
    np.testing.assert_allclose(_updated(B, step, change) @ step, change)
    # A change that shows less than a fifth of the curvature is mixed with what was.
    against = _updated(B, step, -change)
    assert step @ against @ step == pytest.approx(0.2 * curve)
    assert np.linalg.eigvalsh(against).min() > 0
    np.testing.assert_array_equal(_updated(B, 1e-9 * step, change), B)


# --- one motion -----------------------------------------------------------------------


class Slow:
    """A highest speed, as a condition that is not linear."""

    is_linear, names = False, ("speed",)

    def __init__(self, most):
        self.most = most

    def excess(self, path):
        return np.abs(path.v).max(axis=1, keepdims=True) / self.most - 1.0

    def slope(self, path, which):
        return np.zeros((len(which), 4, path.q.shape[1]))


class Above:
    """A lowest position, as a share of the range."""

    is_linear = False

    def __init__(self, limits, share, sign=1.0):
        self.place = limits.low[0] + share * (limits.high[0] - limits.low[0])
        self.sign, self.names = sign, (f"{share}",)

    def excess(self, path):
        return self.sign * (self.place - path.q[:, :1])


ARM = pendulum(2)
LIMITS = Limits.of(ARM)
MARGIN = 1e-3


def program(*more, family=None, limits=LIMITS, count=1):
    seen = observe(ARM.chain)
    return MotionProgram(
        seen, Condition(), family or Fourier(3, 0.2),
        (MotionLimits(limits, ARM.joints), *more), limits,
        np.eye(seen.size), 20.0, 4.0, MARGIN, count,
    )  # fmt: skip


def use(path, limits=LIMITS):
    """Largest share of a limit of position, speed and acceleration, for each joint."""
    x = np.abs(np.stack([path.q - limits.middle, path.v, path.a])).max(axis=1)
    return (x / limits.sizes[:3]).max(axis=0)


@pytest.mark.parametrize("family", [Fourier(3, 0.2), Spline(5.0, 6)])
def test_a_coordinate_of_one_alone_reaches_a_limit(family):
    made = program(family=family)
    for k in range(family.size):
        x = np.zeros(made.scale.shape)
        x[k] = 1.0
        path = made.fine.path(made.coefficients(x.ravel()))
        np.testing.assert_allclose(use(path), 1.0)
        np.testing.assert_allclose(made.point(made.trajectory(x.ravel())), x.ravel())


def test_limits_are_verified_between_the_samples_of_the_design():
    made = program()
    assert len(made.fine.t) - 1 == 10 * (len(made.grid.t) - 1) == 1000
    x = made.random(np.random.default_rng(0))
    excess = made.verified(x)
    path = made.fine.path(made.coefficients(x))
    assert max(excess.values()) == pytest.approx(use(path).max() - 1.0)
    assert made.excess(x) == pytest.approx(max(excess.values()) + MARGIN)


def test_a_random_start_takes_four_fifths_of_a_limit_and_usual_motions_take_all():
    made = program(count=2)
    for part in made.parts(made.random(np.random.default_rng(0))):
        path = made.fine.path(made.coefficients(part))
        np.testing.assert_allclose(use(path), 0.8)
    usual = made.usage(np.random.default_rng(0))
    assert len(usual) == 20
    for path in usual:
        assert len(path.t) == len(made.grid.t)
        assert (use(path) < 1 + 1e-9).all() and (use(path) > 0.9).all()


@pytest.mark.parametrize(
    ("over", "power"),
    [(1.09, 0), (1.11, 1), (1.09 / 0.7**3, 3), (1.11 / 0.7**3, 4), (1e3, 7)],
)
def test_a_random_start_shrinks_until_it_exceeds_no_limit_by_a_tenth(over, power):
    free = program()
    x = free.random(np.random.default_rng(0))
    fastest = np.abs(free.grid.path(free.coefficients(x)).v).max()
    tight = program(Slow(fastest / over))
    start = tight.random(np.random.default_rng(0))
    found = np.abs(tight.grid.path(tight.coefficients(start)).v).max()
    assert found == pytest.approx(fastest * 0.7**power)


def test_a_random_start_is_about_the_posture_that_other_limits_like_best():
    made = program(Above(LIMITS, 2.0))  # as high as can be
    x = made.random(np.random.default_rng(0))
    mean = made.fine.path(made.coefficients(x)).q[:-1].mean(axis=0)
    assert mean[0] == pytest.approx(LIMITS.high[0] / 2, rel=0.02)


def test_postures_are_tried_in_the_middle_half_of_the_range():
    found = program(
        *(Above(LIMITS, x) for x in (0.1, 0.74, 0.76)),
        *(Above(LIMITS, x, -1.0) for x in (0.24, 0.26, 0.9)),
    ).impossible()
    assert found == ("0.76", "0.24")


def test_conditions_enter_a_step_at_their_peaks_within_half_of_their_limit():
    made = program()
    assert made.conditions(np.zeros(made.scale.size))[0].shape == (0,)
    x = made.random(np.random.default_rng(3))
    excess = made.constraints[0].excess(made.fine.path(made.coefficients(x))) + MARGIN
    edge = np.full((1, excess.shape[1]), -np.inf)
    padded = np.concatenate([edge, excess, edge])
    peak = (excess >= padded[:-2]) & (excess > padded[2:])
    expected = excess[peak & (excess > -0.5)]
    assert 0 < len(expected) < peak.sum()
    values, slopes = made.conditions(x)
    np.testing.assert_allclose(values, expected)
    assert slopes.shape == (len(values), x.size)


def test_beside_a_peak_of_a_condition_that_bends_its_neighbours_enter():
    free = program()
    x = free.random(np.random.default_rng(0))
    speed = np.abs(free.grid.path(free.coefficients(x)).v).max(axis=1)
    made = program(Slow(speed.max() / 1.05))
    excess = made.constraints[1].excess(made.grid.path(made.coefficients(x)))[:, 0]
    excess = excess + MARGIN
    padded = np.concatenate([[-np.inf], excess, [-np.inf]])
    peak = (excess >= padded[:-2]) & (excess > padded[2:])
    beside = np.zeros_like(peak)
    for k in np.flatnonzero(peak):
        beside[max(k - 1, 0) : k + 2] = True
    entering = (peak & (excess > -0.5)) | (beside & (excess > -0.1))
    assert (beside & ~entering).any() and (entering & ~peak).any()
    values = made.conditions(x)[0]
    linear = len(free.conditions(x)[0])
    np.testing.assert_allclose(values[linear:], excess[entering])


def test_limits_that_are_exceeded_are_named_with_the_worst_in_front():
    excess = {"a": 0.01, "b": 0.3, "c": -0.1, "d": 0.02, "e": 0.04, "f": 0.0001}
    words = "exceeds the b by 30 %, e by 4 %, d by 2 %, a by 1 %. Valid are"
    assert words in _infeasible(excess)


def test_a_reference_has_two_steps_at_least():
    motion = Trajectory(Fourier(2, 0.2), np.zeros((3, 1)))
    assert len(motion.reference(0.4).t) == 3
    for rate in (0.39, 0.0, np.inf, np.nan):
        with pytest.raises(ExcitationError, match="two samples or more are valid"):
            motion.reference(rate)


def test_a_polynomial_of_degree_five_meets_every_state_on_its_way():
    rng = np.random.default_rng(0)
    t = np.array([0.0, 0.7, 1.0, 3.0])
    states = rng.standard_normal((3, 4, 2))
    curve = quintic(t, *states)
    for order, x in enumerate(states):
        np.testing.assert_allclose(curve(t, nu=order), x, atol=1e-9)
        before = curve(t[1:] - 1e-9, nu=order)
        np.testing.assert_allclose(before, x[1:], atol=1e-5)


# --- criteria and families ------------------------------------------------------------


def test_rounding_of_singular_information_is_no_condition_number():
    assert Condition().value(np.diag([0.0, 4.0])) == pytest.approx(np.sqrt(1e15))
    assert Condition().value(np.diag([1.0, 4.0])) == pytest.approx(2.0)
    assert DOptimal().value(np.diag([1.0, 16.0])) == pytest.approx(0.5)


@pytest.mark.parametrize(("family", "size"), [(Fourier(), 9), (Spline(), 12)])
def test_a_motion_of_which_nothing_is_said_lasts_ten_seconds(family, size):
    assert family.duration == pytest.approx(10.0) and family.size == size
    basis = Grid(family, uniform(family.duration, 50.0)).bases
    assert np.linalg.matrix_rank(basis[0]) == size
    np.testing.assert_allclose(basis[1:3, [0, -1]], 0.0, atol=1e-9)


def test_limits_that_are_not_given_are_shares_of_those_of_the_file():
    np.testing.assert_allclose(LIMITS.high, 0.8 * ARM.q_max)
    np.testing.assert_allclose(LIMITS.speed, 0.8 * ARM.v_max)
    shifted = replace(ARM, q_min=ARM.q_min + 1.0, q_max=ARM.q_max + 1.0)
    np.testing.assert_allclose(Limits.of(shifted, fill=0.5).low, 1.0 - 1.0)
    np.testing.assert_allclose(Limits.of(shifted, fill=0.5).middle, 1.0)
    assert np.isinf(LIMITS.jerk).all()
