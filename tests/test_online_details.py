"""Parts of the online identification by themselves, against closed forms."""

from unittest.mock import patch

import numpy as np
import pytest
from pendulum import pendulum

from hybrid.effects.coulomb import Coulomb
from hybrid.effects.spring import Spring
from hybrid.effects.viscous import Viscous
from hybrid.online import payload_change
from hybrid.online.initial_estimate import InitialEstimate, payload_sizes
from hybrid.online.noise import TorqueNoise
from hybrid.online.payload_change import PayloadChange, likely_payload
from hybrid.online.square_root import SquareRootFilter
from hybrid.plant.scale import joint_scales
from hybrid.regression.problem import build_problem

# --- noise ----------------------------------------------------------------------------


def test_the_first_variance_counts_as_much_as_twenty_errors():
    errors = np.random.default_rng(0).uniform(0.5, 1.5, 60)
    noise = TorqueNoise(np.array([1.0, 2.0]), rate=100.0)
    for count, e in enumerate(errors, 1):
        noise.update([0], [e])
        mean = (20 * 1.0 + (errors[:count] ** 2).sum()) / (20 + count)
        assert noise.std == pytest.approx([np.sqrt(mean), 2.0])


def test_old_errors_are_forgotten_in_five_seconds():
    noise = TorqueNoise(np.array([2.0]), rate=10.0)
    for _ in range(300):
        noise.update([0], [2.0])
    for _ in range(50):
        noise.update([0], [1.0])
    left = (noise.std[0] ** 2 - 1.0) / (4.0 - 1.0)
    assert left == pytest.approx((1 - 1 / 50) ** 50)


def test_a_blow_counts_as_three_standard_deviations_at_most():
    found = []
    for e in (3.0, 1e6):
        noise = TorqueNoise(np.array([1.0]), rate=100.0)
        noise.update([0], [e])
        found.append(noise.std[0] ** 2)
    assert found == pytest.approx([1 + 8 / 21] * 2)


def test_a_joint_without_errors_keeps_a_variance_above_zero():
    noise = TorqueNoise(np.array([1.0]), rate=100.0)
    for _ in range(20_000):
        noise.update([0], [0.0])
    assert noise.std[0] == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize(
    ("rho", "expected"), [(0.0, 1.0), (0.5, 3.0), (0.8, 9.0), (-0.8, 1.0)]
)
def test_errors_alike_count_for_fewer_independent_ones(rho, expected):
    """One error of a long memory is (1 + ρ)/(1 − ρ) successive ones."""
    rng, found = np.random.default_rng(1), []
    noise, e = TorqueNoise(np.ones(3), rate=200.0), np.zeros(3)
    for k in range(15_000):
        e = rho * e + np.sqrt(1 - rho**2) * rng.standard_normal(3)
        noise.update([0, 1, 2], e.tolist())
        found += [noise.inflation] if k > 5000 else []
    assert np.median(found) == pytest.approx(expected, rel=0.1)


def test_equal_errors_count_as_one_in_a_hundred():
    noise = TorqueNoise(np.ones(1), rate=10.0)
    for _ in range(2000):
        noise.update([0], [1.0])
    assert noise.inflation == pytest.approx((1 + 0.98) / (1 - 0.98))


def test_errors_before_and_after_a_stop_do_not_follow_each_other():
    moving, stopping = (TorqueNoise(np.ones(2), rate=10.0) for _ in range(2))
    for _ in range(500):
        moving.update([0], [1.0])
        stopping.update([0], [1.0])
        stopping.update([1], [0.0])
    assert moving.inflation > 50.0 and stopping.inflation == 1.0


# --- payloads -------------------------------------------------------------------------


def test_the_likeliest_payload_is_that_of_ridge_regression():
    rng = np.random.default_rng(0)
    D, root = rng.normal(size=(6, 10)), rng.normal(size=(6, 6))
    D[4] = 0.0  # an unknown that no payload changes
    C, change, sizes = root @ root.T, rng.normal(size=6), rng.uniform(0.5, 2.0, 10)
    used = [0, 1, 2, 3, 5]
    W = np.linalg.inv(C[np.ix_(used, used)])
    H = D[used]
    expected = np.linalg.solve(H.T @ W @ H + np.eye(10), H.T @ W @ change[used])
    np.testing.assert_allclose(likely_payload(change, C, D, sizes), sizes * expected)


RATE, MEMORY = 100.0, 0.4
FADE = np.exp(-1 / (RATE * MEMORY))


def pushed(
    error, inflation=1.0, seconds=12.0, after=11.0, mass=1e3, memories=(MEMORY,)
):
    """Times at which a payload is noticed that shows as an error from a time on."""
    with patch.object(payload_change, "_MEMORIES", memories):
        to = PayloadChange(RATE, mass * np.array([1.0, 0.1, 0.1, 0.1]))
    found, J = [], np.array([[1.0, 0.0, 0.0, 0.0]])
    for k in range(round(seconds * RATE)):
        t = k / RATE
        to.add(J, np.array([error * (t >= after)]))
        statistic = to.detect(t, inflation)
        found += [] if statistic is None else [(t, statistic)]
    return found


@pytest.mark.parametrize("inflation", [1.0, 4.0, 1e3])
def test_a_lasting_error_is_worth_its_square_by_independent_errors(inflation):
    """Sums that fade have the variance of 1/(1 + fade) of their information."""
    count = 1 / (1 - FADE) / min(inflation, 1 / (1 - FADE))
    at_threshold = np.sqrt(50.0 / ((1 + FADE) * count))
    assert not pushed(0.98 * at_threshold, inflation, seconds=15.0)
    (t, statistic), *_ = pushed(1.02 * at_threshold, inflation, seconds=15.0)
    assert 11.0 < t < 13.5 and statistic == pytest.approx(50.0, rel=0.02)


def test_nothing_is_noticed_in_the_first_ten_seconds_nor_one_after_a_change():
    times = [t for t, _ in pushed(10.0, seconds=14.0, after=0.0)]
    assert times[0] == pytest.approx(10.0)
    assert np.diff(times) == pytest.approx(np.ones(len(times) - 1), abs=0.011)


def test_the_usual_mass_limits_what_a_change_is_worth():
    """Ten deviations are noticed at the fourth error, as 2·100·4²/40 is above 50."""
    (first, _), *_ = pushed(10.0, mass=1e3)
    assert first == pytest.approx(11.03)
    assert not pushed(10.0, mass=0.01)


def test_of_two_memories_the_short_one_is_sooner_and_the_long_one_sees_more():
    strong = [pushed(4.0, memories=x)[0][0] for x in ((0.1,), (0.4,), (0.1, 0.4))]
    assert strong[2] == min(strong[:2])
    weak = 1.1 * np.sqrt(50.0 * (1 - FADE) / (1 + FADE))
    assert pushed(weak, seconds=14.0, memories=(0.1, 0.4))
    assert not pushed(weak, seconds=14.0, memories=(0.1,))


# --- the recursive filter -------------------------------------------------------------


def update(to, H, error, forgetting=1.0):
    for _ in to.update(H @ to.root, error, forgetting):
        pass


def test_without_forgetting_it_is_the_regression_of_all_rows():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    mean, P = rng.normal(size=4), root @ root.T
    to = SquareRootFilter(mean, root)
    H, y = rng.normal(size=(30, 2, 4)), rng.normal(size=(30, 2))
    for h, x in zip(H, y, strict=True):
        update(to, h, x - h @ to.mean)
    X, x = H.reshape(-1, 4), y.ravel()
    A = np.linalg.inv(P) + X.T @ X
    expected = np.linalg.solve(A, np.linalg.solve(P, mean) + X.T @ x)
    np.testing.assert_allclose(to.mean, expected, rtol=1e-9)
    np.testing.assert_allclose(to.covariance, np.linalg.inv(A), rtol=1e-8)
    np.testing.assert_allclose(to.std, np.sqrt(np.diag(to.covariance)))


@pytest.mark.parametrize("start", [1e-6, 0.05, 30.0])
def test_with_forgetting_it_settles_at_a_share_of_the_noise_and_never_grows(start):
    """(1 − λ) of the variance of one row; below it, nothing is forgotten."""
    to = SquareRootFilter(np.zeros(2), np.sqrt(start) * np.eye(2))
    H = np.array([[2.0, 0.0]])
    for _ in range(2000):
        update(to, H, np.array([1.0]), 0.98)
    expected = min(start, 0.02 / 4.0)
    np.testing.assert_allclose(to.covariance, np.diag([expected, start]), rtol=1e-6)


def test_an_estimate_outside_its_bounds_takes_what_is_correlated_with_it_along():
    P = np.array([[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 4.0]])
    to = SquareRootFilter(np.array([2.0, 2.0, -3.0]), np.linalg.cholesky(P))
    free = np.full(3, np.inf)
    to.clip(-free, free)
    np.testing.assert_array_equal(to.mean, [2.0, 2.0, -3.0])
    to.clip(np.array([-np.inf, -np.inf, 0.0]), np.array([1.0, np.inf, np.inf]))
    np.testing.assert_allclose(to.mean, [1.0, 1.5, 0.0], atol=1e-9)


def test_an_unknown_that_is_certain_is_set_to_its_bound_alone():
    to = SquareRootFilter(np.array([2.0, 1.0]), np.zeros((2, 2)))
    to.clip(np.zeros(2), np.array([1.5, 9.0]))
    np.testing.assert_allclose(to.mean, [1.5, 1.0])


def test_covariance_that_is_added_is_that_of_its_directions():
    rng = np.random.default_rng(3)
    root, D = rng.normal(size=(4, 4)), rng.normal(size=(4, 7))
    to = SquareRootFilter(np.zeros(4), root)
    to.add_covariance(D)
    np.testing.assert_allclose(to.covariance, root @ root.T + D @ D.T, atol=1e-12)


# --- before the first sample ----------------------------------------------------------


def at_first(**values):
    robot = pendulum()
    effects = [
        Viscous((0,), {"coefficient": values.get("viscous", 0.0)}),
        Coulomb((0,), {"level": values.get("coulomb", 0.0)}),
    ]
    problem = build_problem(robot.chain, effects)
    return InitialEstimate(problem, joint_scales(robot), 0.5, 0.0), problem


def test_links_and_gains_are_as_uncertain_as_a_share_of_their_size():
    """A rod of 2 kg: its size is that of its moments and 15 cm about each of them."""
    first, problem = at_first(viscous=1e3)
    moment = 0.6 + 0.15 * 2.0
    inertia = 0.24 + 0.15 * moment
    (scale,) = joint_scales(pendulum())
    sizes = [2.0, *3 * [moment + 0.01], *6 * [inertia + 0.001]]
    sizes += [1e3, 0.04 * scale.torque]  # as it is, and as is usual
    directions = problem.base.mapping * (0.5 * np.array(sizes))
    np.testing.assert_allclose(
        first.root @ first.root.T, directions @ directions.T, rtol=1e-9, atol=1e-12
    )


def test_a_weightless_link_is_as_uncertain_as_a_flange():
    robot = pendulum().with_inertial(np.zeros((1, 10)))
    problem = build_problem(robot.chain, [])
    first = InitialEstimate(problem, joint_scales(robot), 1.0, 0.0)
    sizes = np.array([0.1, *3 * [0.01], *6 * [0.001]])
    directions = problem.base.mapping * sizes
    np.testing.assert_allclose(first.root @ first.root.T, directions @ directions.T)


def test_bounds_are_those_of_the_joint_or_twice_what_is_there():
    (scale,) = joint_scales(pendulum())
    for level in (0.0, 10 * scale.torque):
        first, problem = at_first(coulomb=level)
        low, high = first.bounds()
        dry = problem.base.kept_labels.index("coulomb.level[hinge_0]")
        assert low[dry] == 0.0
        assert high[dry] == pytest.approx(max(0.3 * scale.torque, 2 * level))
        links = [k for k in problem.rigid if k not in {u for u, *_ in problem.gains}]
        assert np.isinf(high[links]).all() and np.isinf(low[links]).all()


def test_a_payload_is_a_change_of_the_last_link():
    first, problem = at_first()
    sizes = payload_sizes(2.0)
    np.testing.assert_allclose(sizes, [2.0, *3 * [0.3], *6 * [0.045]])
    found = first.payload_directions(sizes)
    heavier = problem.base.mapping[:, :10] @ np.diag(sizes)
    np.testing.assert_allclose(found[: problem.size], heavier)


def test_a_gain_that_is_usually_zero_is_as_uncertain_as_a_tenth_of_its_bounds():
    robot = pendulum()
    (scale,) = joint_scales(robot)
    for effect, expected in (
        (Spring((0,), {"preload": 0.0}), {"stiffness": 0.2, "preload": 0.2}),
        (Viscous((0,)), {"coefficient": 0.1 / scale.speed}),
    ):
        problem = build_problem(robot.chain, [effect])
        first = InitialEstimate(problem, joint_scales(robot), 1.0, 0.0)
        names = [effect.gains[g].name for _, g in problem.columns]
        usual = [expected[x] * scale.torque for x in names]
        np.testing.assert_allclose(first._gain_sizes(), usual)
