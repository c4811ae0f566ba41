"""Evidence: the same numbers as Bayesian regression written out, sample by sample."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from hybrid.diagnosis.answer.unseen import left_unseen
from hybrid.diagnosis.evidence.bayes import PRIOR_FACTORS, log_bayes
from hybrid.diagnosis.evidence.contacts import _OF_ALL, _Stretch
from hybrid.diagnosis.evidence.evidence import Evidence
from hybrid.diagnosis.evidence.noise import low_frequency_excess, without_events
from hybrid.diagnosis.evidence.noise_model import NoiseModel, estimate_noise
from hybrid.diagnosis.evidence.ripples import ripple_orders
from hybrid.diagnosis.prior import Prior
from hybrid.signals import autocorrelation_time, butterworth

M = 60


def one_joint(left, *, block=50, cutoff=np.inf):
    """A made-up gap of one joint that moves all the time, 100 Hz."""
    return SimpleNamespace(
        robot=SimpleNamespace(size=1),
        left=left[:, None],
        moving=np.ones((len(left), 1), dtype=bool),
        measured=np.ones((len(left), 1)),
        fold=np.arange(len(left)) // block % 4,
        rate=100.0,
        cutoff=cutoff,
    )


def problem(seed=0, widths=(2, 1, 3)):
    """A made-up gap of two joints with some blocks of columns."""
    rng = np.random.default_rng(seed)
    gap = SimpleNamespace(
        robot=SimpleNamespace(size=2),
        left=rng.standard_normal((M, 2)),
        moving=rng.random((M, 2)) < 0.9,
        measured=rng.standard_normal((M, 2)),
        fold=np.arange(M) // 10 % 3,
        rate=100.0,
    )
    blocks = [
        {j: rng.standard_normal((M, p)) for j in ((0, 1) if k == 0 else (k % 2,))}
        for k, p in enumerate(widths)
    ]
    std = [np.exp(rng.standard_normal(p)) for p in widths]
    evidence = Evidence(gap, None)
    index = evidence.add(blocks, std)
    evidence.noise = np.array([0.7, 1.9])
    return gap, blocks, std, evidence, index


def dense(gap, blocks, std, noise):
    """Everything stacked: columns, torque, noise variance and prior variance."""
    columns, y, variance = [], [], []
    for i in range(2):
        rows = gap.moving[:, i]
        parts = [
            b.get(i, np.zeros((M, len(s)))) for b, s in zip(blocks, std, strict=True)
        ]
        columns.append(np.hstack(parts)[rows])
        y.append(gap.left[rows, i])
        variance.append(np.full(rows.sum(), noise[i]))
    X, y = np.vstack(columns), np.concatenate(y)
    return X, y, np.concatenate(variance), np.concatenate(std) ** 2


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25)
def test_the_evidence_is_that_of_the_whole_covariance(seed):
    gap, blocks, std, evidence, index = problem(seed)
    X, y, noise, prior = dense(gap, blocks, std, evidence.noise)
    zero = np.zeros(len(y))
    with_all = multivariate_normal(zero, np.diag(noise) + X * prior @ X.T).logpdf(y)
    without = multivariate_normal(zero, np.diag(noise)).logpdf(y)
    found = evidence.solve(np.concatenate(index))
    assert found.evidence == pytest.approx(with_all - without, abs=1e-8)
    A = X.T / noise @ X + np.diag(1 / prior)
    np.testing.assert_allclose(found.gains, np.linalg.solve(A, X.T @ (y / noise)))
    np.testing.assert_allclose(found.covariance, np.linalg.inv(A), atol=1e-12)


def test_screening_and_trying_add_what_solving_both_says():
    """With the best of some widths of the prior, less the odds of each."""
    gap, blocks, std, evidence, index = problem(1)
    lower = [np.full(len(s), -np.inf) for s in std]
    base, every = np.concatenate(index[:2]), np.concatenate(index)
    (screened,) = evidence.screen(base, [index[2]], [lower[2]])
    tried, gains, factor = evidence.trial(base, blocks[2], std[2], lower[2])
    without, added = evidence.solve(base).evidence, {}
    for wider in PRIOR_FACTORS:
        evidence.scale_prior(index[2], wider)
        whole = evidence.solve(every)
        added[wider] = whole.evidence - without - abs(np.log(wider))
        if wider == factor:
            np.testing.assert_allclose(gains, whole.gains[-len(gains) :])
    assert factor == max(added, key=added.__getitem__)
    assert screened == pytest.approx(added[factor])
    assert tried == pytest.approx(added[factor])


@pytest.mark.parametrize("white", [True, False])
def test_another_gap_beside_the_same_columns_is_solved_as_from_the_start(white):
    gap, blocks, std, evidence, index = problem(2)
    base, own = np.concatenate(index[:-1]), index[-1]
    gap.trajectory = np.zeros(M, dtype=int)
    coloured = [] if white else [np.array([x, 0.4 * x]) for x in evidence.noise]
    lower = np.full(len(own), -np.inf)

    def told(found):
        tried = found.trial(base, blocks[-1], std[-1], lower)
        screened = found.screen(base, [own], [lower])
        return [*found.solve(base).gains, tried.worth, *tried.gains, *screened]

    if coloured:
        evidence.set_covariances(coloured)
    first, before = gap.left, told(evidence)
    gap.left = np.random.default_rng(5).standard_normal(gap.left.shape)
    evidence.set_left(gap.left)
    fresh = Evidence(gap)
    fresh.noise = evidence.noise
    fresh.add(blocks, std)
    if coloured:
        fresh.set_covariances(coloured)
    np.testing.assert_allclose(told(evidence), told(fresh))
    np.testing.assert_allclose(evidence.power, fresh.power)
    evidence.set_left(first)
    np.testing.assert_allclose(told(evidence), before)


def test_squares_are_those_of_the_residual():
    _, _, _, evidence, index = problem(2)
    found = evidence.solve(np.concatenate(index))
    squares = evidence.squares(found.index, found.gains)
    for i in range(2):
        left = evidence.residual(i, found.index, found.gains)
        assert squares[i] == pytest.approx(left @ left)


def test_what_is_lost_on_a_fold_is_by_the_gains_of_all_others():
    gap, blocks, std, evidence, index = problem(7)
    X, y, noise, prior = dense(gap, blocks, std, evidence.noise)
    fold = np.concatenate([gap.fold[gap.moving[:, i]] for i in range(2)])
    expected = np.zeros((3, 1))
    for f in range(3):
        fit, test = fold != f, fold == f
        A = X[fit].T / noise[fit] @ X[fit] + np.diag(1 / prior)
        gains = np.linalg.solve(A, X[fit].T @ (y[fit] / noise[fit]))
        expected[f] = np.sum((y[test] - X[test] @ gains) ** 2 / noise[test])
    expected = np.tile(expected, 2)  # of white noise both losses are the same
    index = np.concatenate(index)
    np.testing.assert_allclose(evidence.held_out_losses(index), expected)
    gap.trajectory = np.zeros(M, dtype=int)
    evidence.set_covariances([np.array([x]) for x in evidence.noise])
    np.testing.assert_allclose(evidence.held_out_losses(index), expected)


def test_noise_is_found_beside_many_columns():
    """Forty columns on 600 samples of noise, and torque along some of them."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(20):
        X = rng.standard_normal((600, 40))
        left = X[:, :5] @ rng.standard_normal(5) + 0.3 * rng.standard_normal(600)
        evidence = Evidence(one_joint(left), None)
        (index,) = evidence.add([{0: X}], [np.ones(40)])
        estimate_noise(evidence, index)
        found.append(evidence.noise[0])
    assert np.median(found) == pytest.approx(0.09, rel=0.2)


def noisy(rng, *, samples, columns, used=0, size=1.0):
    """Evidence of white noise, 0.3 RMS, and torque along the first columns."""
    X = rng.standard_normal((samples, columns))
    torque = size * X[:, :used] @ np.ones(used)
    gap = one_joint(torque + 0.3 * rng.standard_normal(samples))
    evidence = Evidence(gap, None)
    return evidence, *evidence.add([{0: X}], [np.ones(columns)])


def test_noise_is_found_beside_nearly_as_many_columns_as_samples():
    rng = np.random.default_rng(6)
    found = []
    for _ in range(20):
        evidence, index = noisy(rng, samples=400, columns=250)
        estimate_noise(evidence, index)
        found.append(evidence.noise[0])
    assert np.median(found) == pytest.approx(0.09, rel=0.2)


def test_noise_is_not_small_where_many_columns_take_it():
    """Filtered noise has few dimensions, and columns rest for the last second."""
    rng, found = np.random.default_rng(8), []
    for _ in range(20):
        columns = rng.standard_normal((400, 100)) * (np.arange(400) < 300)[:, None]
        torque = 5.0 * columns.sum(axis=1) + 0.3 * rng.standard_normal(400)
        slow = partial(butterworth, rate=100.0, cutoff=15.0)
        gap = one_joint(slow(torque), cutoff=15.0)
        evidence = Evidence(gap, None)
        (index,) = evidence.add([{0: slow(columns)}], [np.ones(100)])
        estimate_noise(evidence, index)
        found.append(evidence.noise[0])
    assert np.median(found) > 0.5 * 0.09


@pytest.mark.parametrize("measured", [4.0, 0.05])
def test_noise_and_errors_of_laws_are_no_more_than_an_explanation_leaves(measured):
    """Four fifths of the columns are the true ones; the others alone explain little."""
    rng = np.random.default_rng(9)
    evidence, index = noisy(rng, samples=600, columns=50, used=40)
    evidence.noise[:] = measured
    evidence.covariances = [np.array([measured, measured / 2])]
    gap = float(np.mean(evidence.residuals(index[:0])[0] ** 2))
    model = NoiseModel(evidence, Prior(law_error=0.5))
    assert not model.lower(index[:0], index[:5])
    assert model.measured == measured and model.law_errors == 0.5
    assert model.lower(index[:0], index)
    noise, law = evidence.covariances[0][0], model.law_errors[0] ** 2 * gap
    assert noise + law == pytest.approx(0.09, rel=0.2)
    assert model.measured[0] == pytest.approx(min(measured, 0.09), rel=0.4)
    assert not model.lower(index[:0], index)


def test_noise_is_not_what_happened_once():
    """Noise, and a jolt a hundred times as large on one stretch of a second."""
    rng = np.random.default_rng(5)
    X = rng.standard_normal((1200, 10))
    left = 0.3 * rng.standard_normal(1200)
    left[300:400] += 30.0
    gap = one_joint(left, block=100)
    evidence = Evidence(gap, None)
    (index,) = evidence.add([{0: X}], [np.ones(10)])
    estimate_noise(evidence, index)
    assert evidence.noise[0] == pytest.approx(0.09, rel=0.3)
    gap.measured[:] = 1000.0  # of which solvers are a part in five hundred off
    estimate_noise(evidence, index)
    assert evidence.noise[0] >= 4.0


@given(st.integers(0, 1000), st.integers(1, 4), st.booleans())
def test_several_candidates_at_once_are_each_alone(seed, size, fixed):
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(5, 8, size))
    H, s = X.transpose(0, 2, 1) @ X, 5.0 * rng.normal(size=(5, size))
    prior, lower = (
        rng.uniform(0.1, 2.0, (5, size)),
        rng.choice([-np.inf, 0.0], (5, size)),
    )
    fixed_gains = rng.uniform(0.1, 2.0, (5, size)) if fixed else None
    worth, gains = log_bayes(H, s, prior, lower, fixed_gains)
    assert worth.shape == (5,)
    for k in range(5):
        own = None if fixed_gains is None else fixed_gains[k]
        alone, best = log_bayes(H[k], s[k], prior[k], lower[k], own)
        assert worth[k] == pytest.approx(float(alone))
        assert gains[k] == pytest.approx(best)
        assert np.all(best >= lower[k]) or fixed


def test_a_gain_stays_within_its_physical_bound():
    H, s = np.diag([4.0, 4.0]), np.array([-8.0, 6.0])
    free, _ = log_bayes(H, s, np.ones(2), np.full(2, -np.inf))
    bound, gains = log_bayes(H, s, np.ones(2), np.zeros(2))
    assert gains[0] == 0.0
    assert gains[1] == pytest.approx(6.0 / 5.0)
    assert bound < free


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_memory_counts_samples_for_an_independent_one(rho):
    rng = np.random.default_rng(5)
    found = []
    for _ in range(20):
        x = np.zeros(4000)
        steps = rng.standard_normal(4000)
        for k in range(1, 4000):
            x[k] = rho * x[k - 1] + steps[k]
        rows = np.flatnonzero(rng.random(4000) < 0.8)  # with gaps, as where it stands
        found.append(autocorrelation_time(x[rows], rows))
    assert np.median(found) == pytest.approx((1 + rho) / (1 - rho), rel=0.15)


@pytest.mark.parametrize("seed", range(5))
def test_memory_is_the_sum_of_pairs_of_correlations_while_these_are_positive(seed):
    rng = np.random.default_rng(seed)
    row = np.array([3, *range(40, 140)])[rng.random(101) < 0.9]
    x = np.cumsum(rng.standard_normal(len(row)))  # with a mean: it lasts long
    apart = np.subtract.outer(row, row)
    product = np.outer(x, x) / np.mean(x**2)
    lags = np.arange((row[-1] - row[0] + 1) // 4 * 2)  # half of it, in pairs
    correlation = [product[apart == k].mean() if k in apart else 0.0 for k in lags]
    pairs = np.add(correlation[::2], correlation[1::2])
    positive = np.cumprod(pairs >= 0).astype(bool)
    expected = max(1.0, 2 * pairs[positive].sum() - 1)
    assert autocorrelation_time(x, row) == pytest.approx(expected)


def test_a_stretch_in_which_something_happened_is_not_quiet():
    x = np.random.default_rng(2).standard_normal(1000)
    x[300:350] *= 10.0  # half a second
    np.testing.assert_array_equal(
        without_events(x, np.arange(1000), 100.0), np.arange(1000) // 50 != 6
    )


@pytest.mark.parametrize("size", [0.0, 0.3, 2.0])
def test_what_is_stronger_at_low_frequencies_is_told_from_noise(size):
    rng, t = np.random.default_rng(3), np.arange(6000) / 200.0
    rows = np.flatnonzero((t % 5.0) < 4.0)
    wave, found = size * np.sin(2 * np.pi * 0.7 * t), []
    for _ in range(10):
        x = butterworth(rng.standard_normal(len(t)), rate=200.0, cutoff=40.0) + wave
        found.append(low_frequency_excess(x[rows], rows, 200.0, 40.0))
    expected = wave[rows] @ wave[rows]
    assert np.median(found) == pytest.approx(expected, rel=0.1, abs=150.0)


@pytest.mark.parametrize(
    ("fixed_gains", "its_own"), [(1.0, True), (10.0, False), (0.1, False)]
)
def test_columns_of_one_gain_do_not_explain_at_quite_another(fixed_gains, its_own):
    H, s, one = np.array([[4.0]]), np.array([4.0]), np.ones(1)
    free, best = log_bayes(H, s, one, np.zeros(1))
    worth, gains = log_bayes(H, s, one, np.zeros(1), np.array([fixed_gains]))
    pinned = fixed_gains * 4.0 - 0.5 * fixed_gains**2 * 4.0
    assert worth == pytest.approx(free if its_own else pinned)
    assert gains == pytest.approx(best if its_own else [fixed_gains])


def test_the_gains_of_some_columns_are_in_their_order():
    *_, evidence, index = problem()
    solution = evidence.solve(np.concatenate(index[::-1]))
    together = dict(zip(solution.index.tolist(), solution.gains, strict=True))
    wanted = np.concatenate([index[1], index[2][::-1]])
    assert solution.of(wanted).tolist() == [together[int(k)] for k in wanted]
    assert evidence.add([], []) == []


def test_what_is_too_slow_for_noise_is_never_more_than_all_of_it():
    """A constant, above all: it is at one frequency, not at two."""
    rng = np.random.default_rng(3)
    x = 5.0 + rng.standard_normal(400)
    slow = low_frequency_excess(x, np.arange(400), 100.0, 20.0)
    assert 0.9 < slow / (x @ x) < 1.0


def test_orders_of_a_ripple_are_the_strongest_waves_over_position():
    rng, t = np.random.default_rng(0), np.arange(0.0, 20.0, 0.005)
    q, v = 2.0 * np.sin(1.3 * t), 2.6 * np.cos(1.3 * t)
    left = np.sin(7 * q) + 0.6 * np.cos(31 * q) + 0.2 * rng.standard_normal(len(t))
    assert set(ripple_orders(left, q, v, 100.0, 2)) == {7, 31}
    assert ripple_orders(left, q, v, 100.0, 1) == [7]
    # Below 2 Hz the faster one is hardly seen, and noise of its order stays noise.
    assert ripple_orders(left, q, v, 2.0, 1) == [7]
    # The last order that is tried is 399: one beyond a peak has to be lower.
    assert ripple_orders(np.sin(399 * q), q, v, 1e4, 1) == [399]


@pytest.mark.parametrize(
    ("of", "first", "meets"),
    [(0, 12, True), (0, 20, True), (0, 21, False), (1, 12, False), (_OF_ALL, 12, True)],
)
def test_contacts_meet_in_the_same_recording_at_the_same_time(of, first, meets):
    """From the tenth chunk to the twentieth of one, and ten of the same or another."""
    own, other = _Stretch(9.0, 10, 10, 0), _Stretch(5.0, first, 10, of)
    assert own.meets(other) == other.meets(own) == meets


@pytest.mark.parametrize(
    ("before", "after", "part"), [(1.0, 1.0, 0.0), (9.0, 1.0, 0.0), (100.0, 50.0, 0.5)]
)
def test_what_is_left_unseen_counts_beyond_noise_only(before, after, part):
    """Mean squares of a joint's gap on motions kept apart, in units of noise."""
    gap = [[np.sqrt(x) * np.ones(1000)] for x in (before, after)]
    left = left_unseen(
        SimpleNamespace(before=gap[0], after=gap[1]),
        SimpleNamespace(noise=np.ones(1)),
    )
    assert left == pytest.approx(part, abs=0.01)


def test_no_two_simulators_agree_by_noise_that_has_no_memory():
    rng = np.random.default_rng(0)
    gap = one_joint(rng.standard_normal(400), cutoff=20.0)
    gap.measured, gap.subtracted = 30.0 * rng.standard_normal((400, 1)), None
    gap.trajectory = np.zeros(400, dtype=int)
    evidence = Evidence(gap, None)
    (index,) = evidence.add([{0: rng.standard_normal((400, 2))}], [np.ones(2)])
    kept = evidence.covariances[0].copy()
    model = NoiseModel(evidence, Prior(law_error=0.0, solver_error=0.1))
    model.apply(index)
    (found,) = model.covariances
    np.testing.assert_array_equal(found[1:], kept[1:])
    added = 0.1**2 * gap.measured.var()
    assert found[0] > kept[0] + added
    assert evidence.noise[0] == pytest.approx(1.0 + added, rel=0.5)


def test_gains_may_be_held_to_a_part_of_the_size_they_came_with():
    _, _, std, evidence, index = problem()
    evidence.scale_prior(index[1], 0.1)
    expected = np.concatenate([std[0], 0.1 * std[1], std[2]]) ** -2.0
    np.testing.assert_allclose(evidence.precision, expected)
