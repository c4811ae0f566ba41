"""The intake of a stream, sample by sample, and the filters behind it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, lfilter_zi

from hybrid.errors import IdentificationError
from hybrid.online import Sample
from hybrid.online.health import Health
from hybrid.online.intake import Intake
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial


def intake(size=2, **options):
    settings = {"rate": 100.0, "window": 0.1, "speed": 10.0, "torque": 50.0}
    return Intake(size, before=4, block=3, **(settings | options))


def moving(t, q=None):
    return Sample(t, np.full(2, 0.1 * t) if q is None else q, np.array([1.0, t % 9]))


def test_blocks_follow_each_other_with_the_samples_before_them():
    """The intake counts time from its first sample, at a period."""
    to, blocks = intake(), []
    for k in range(16):
        block = to.take(moving(5.0 + k / 100))
        blocks += [] if block is None else [block]
    assert [len(x) for x in blocks] == [7] * 4
    for j, block in enumerate(blocks):
        first = 3 * j
        np.testing.assert_allclose(block[:, 0], 0.01 * np.arange(first + 1, first + 8))
        np.testing.assert_allclose(
            block[:, 4], 5.0 + 0.01 * np.arange(first, first + 7)
        )


def test_a_sample_has_as_many_numbers_of_each_kind_as_joints():
    with pytest.raises(IdentificationError, match="4 numbers .* valid are 2 of each"):
        intake().take(Sample(0.0, np.zeros(1), np.zeros(3)))


@settings(max_examples=60)
@given(st.lists(st.sampled_from(["good", "gap", "nan"]), min_size=5, max_size=60))
def test_what_is_lost_and_missing_is_counted_by_periods(kinds):
    """The share lost is that of periods, each worth less by what came since."""
    to, k, periods, lost = intake(window=1.0), 1, [], 0.0
    to.take(moving(0.0))
    for kind in kinds:
        if kind == "gap":
            k += 4
        bad = np.full(2, np.nan) if kind == "nan" else None
        to.take(moving(k / 100, bad))
        periods += [1.0] * (4 * (kind == "gap")) + [float(kind == "nan")]
        k += 1
    to.take(moving(k / 100))  # only what comes shows what is missing before
    for one in (*periods, 0.0):
        lost += (one - lost) / (1.0 + 100.0)
    health = to.health
    assert health.not_finite == kinds.count("nan") and health.restarts == 0
    assert health.missing == 4 * kinds.count("gap")
    # Of a period whose sample came and is no good, only the order may differ.
    assert health.lost == pytest.approx(lost, rel=0.2, abs=1e-12)


def test_after_a_gap_the_share_lost_is_as_if_each_sample_had_been_left_out():
    gap, bad = intake(window=1.0), intake(window=1.0)
    for k in range(30):
        gap.take(moving(k / 100))
        bad.take(moving(k / 100))
    for k in range(30, 37):
        bad.take(moving(k / 100, np.full(2, np.nan)))
    for to in (gap, bad):
        to.take(moving(0.37))
        assert to.health.missing == (7 if to is gap else 0)
    kept = (1.0 - 1.0 / 101.0) ** 8
    assert bad.health.lost == pytest.approx((1.0 - (100 / 101) ** 7) * 100 / 101)
    assert 1.0 - gap.health.lost == pytest.approx(1.0 - bad.health.lost, abs=1 - kept)
    assert gap.health.lost == pytest.approx(bad.health.lost, rel=0.02)


@pytest.mark.parametrize(
    ("stamp", "q", "tau", "fate"),
    [
        (0.002, [0.01, 0.01], [1.0, 2.0], "used"),
        (0.0005, [0.001, 0.001], [1.0, 2.0], "repeated"),
        (0.010, [0.0, 0.0], [1.0, 0.0], "repeated"),
        (0.010, [0.0, 0.0], [1.0, 0.1], "used"),
        (-0.001, [0.0, 0.0], [1.0, 0.1], "late"),
        (0.020, [0.1, 0.1], [1.0, 0.1], "used"),
        (0.120, [0.1, 0.1], [1.0, 0.1], "jumped"),
        (0.010, [0.05, 0.05], [1.0, 0.1], "used"),
        (0.010, [0.08, 0.08], [1.0, 0.1], "implausible"),
        (0.010, [0.01, 0.01], [40.0, 29.0], "used"),
        (0.010, [0.01, 0.01], [40.0, 31.0], "implausible"),
        (0.010, [2e6, 0.01], [0.0, 0.0], "implausible"),
        (2e15, [0.01, 0.01], [0.0, 0.0], "implausible"),
        (0.010, [np.inf, 0.0], [0.0, 0.0], "not_finite"),
        (np.nan, [0.0, 0.0], [0.0, 0.0], "not_finite"),
    ],
)
def test_the_fate_of_a_sample_is_that_of_what_it_says(stamp, q, tau, fate):
    # Together 10 rad/s and 50 N·m; a gap of a quarter of the window is bridged.
    to = intake(window=0.4)
    to.take(Sample(0.0, np.zeros(2), np.array([1.0, 0.0])))
    to.take(Sample(stamp, np.array(q), np.array(tau)))
    health = to.health
    assert getattr(health, fate) == 1 + (fate == "used") and health.received == 2


@pytest.mark.parametrize("fate", ["jumped", "late", "implausible"])
def test_ten_samples_must_follow_each_other_before_a_new_place_is_believed(fate):
    ahead = {"jumped": 100.0, "late": -100.0, "implausible": 0.01}[fate]
    away = np.full(2, 9.0 if fate == "implausible" else 0.0)
    to = intake()
    to.take(moving(0.0))
    for k in range(9):
        to.take(moving(ahead + k / 100, away + k / 1000))
    to.take(moving(ahead + 50.0, -away - 5.0))  # one beside: counting begins anew
    for k in range(10):
        assert to.health.restarts == 0
        to.take(moving(ahead + 60.0 + k / 100, away + k / 1000))
    assert to.health.used == 1
    to.take(moving(ahead + 60.1, away + 0.01))
    assert to.health.used == 2 and to.health.restarts == 1
    assert to.now == ahead + 60.1


# --- filters of a stream --------------------------------------------------------------


@settings(max_examples=30)
@given(
    seed=st.integers(0, 10_000),
    rate=st.sampled_from([50.0, 333.0, 1000.0]),
    group=st.sampled_from([1, 3]),
)
def test_a_polynomial_of_fourth_order_is_known_at_any_stamps(seed, rate, group):
    rng = np.random.default_rng(seed)
    to = LocalPolynomial(rate, rate / 12, group)
    count = 2 * to.margin + 5 * group
    for size in (count, count + group, count):
        t = (np.arange(size) + rng.uniform(-0.2, 0.2, size)) / rate
        curve = [np.polynomial.Polynomial(c) for c in rng.normal(size=(2, 5))]
        scale = t[-1]
        q = np.stack([p(t / scale) for p in curve], axis=1)
        powers, whole = to.windows(t)
        fitted = to.fit(to.moments(powers, q))
        assert whole.all() and len(fitted) == (size - 2 * to.margin) // group
        assert np.abs(to.residual(powers, q, fitted)).max() < 1e-9
        first = np.arange(len(fitted))[:, None] * group + to.margin
        middle = t[first + np.arange(group)].mean(axis=1) / scale
        for order, found in enumerate(to.states(fitted)):
            exact = np.stack([p.deriv(order)(middle) for p in curve], axis=1)
            np.testing.assert_allclose(
                found * scale**order, exact, rtol=1e-7, atol=1e-7
            )


@pytest.mark.parametrize("late", [0, -1])
def test_a_window_that_lasts_too_long_or_half_as_long_is_not_whole(late):
    """Its bandwidth would be less than it has to be, wherever the gap is."""
    to = LocalPolynomial(1000.0, 50.0)
    t = np.arange(2 * to.margin + 1) / 1000.0
    assert to.windows(t)[1].all() and not to.windows(t / 2)[1].any()
    t[late] += np.sign(late + 0.5) * -0.3 * to.span
    assert not to.windows(t)[1].any()


def test_a_window_has_at_least_three_samples_on_either_side():
    assert LocalPolynomial(100.0, 19.9).margin == 3
    assert LocalPolynomial(100.0, 19.9, 9).margin == 3
    wide = LocalPolynomial(1000.0, 10.0)
    assert wide.margin == round(((5 * 1000 / 50) + 4.6) / 3.2)


def test_a_window_of_noise_is_spread_and_one_of_a_single_error_is_not():
    to = LocalPolynomial(1000.0, 20.0)
    left = np.random.default_rng(0).normal(size=(1, 2 * to.margin + 1, 2))
    assert to.has_no_outlier(left).all()
    left[0, 4, 1] = 100.0
    assert to.has_no_outlier(left).tolist() == [[True, False]]


@pytest.mark.parametrize("block", [1, 4, 10])
def test_a_low_pass_by_blocks_is_the_filter_of_all_samples(block):
    b, a = butter(2, 10.0, fs=500.0)
    x = np.random.default_rng(0).normal(size=(40, 3)) + 5.0
    expected = lfilter(b, a, x, axis=0, zi=np.multiply.outer(lfilter_zi(b, a), x[0]))[0]
    to = BlockLowPass(500.0, 10.0, block)
    found = [to(x[k : k + block]) for k in range(0, 40, block)]
    np.testing.assert_allclose(found, expected[block - 1 :: block], rtol=1e-9)


def test_before_its_first_sample_nothing_is_lost_and_the_rate_is_as_stated():
    assert intake().health == Health(rate=100.0, stated_rate=100.0)
    assert np.isnan(intake().now)
