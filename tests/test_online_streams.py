"""Online identification on streams as robots give them, on good days and bad."""

import sys
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, lfilter_zi
from streams import FAULTS, damaged
from test_online import RATE, after_thirty_seconds, arm, effects, log, tracked

from hybrid.errors import IdentificationError
from hybrid.online import Health, OnlineIdentifier, Sample
from hybrid.online.intake import Intake
from hybrid.signals.streaming import BlockLowPass, LocalPolynomial

LEFT_OUT = ("not_finite", "implausible", "repeated", "late", "jumped")


def tracker(**options):
    return OnlineIdentifier(arm(), effects(), rate=RATE, **options)


def fed(samples, to=None):
    to = to or tracker()
    for sample in samples:
        to.update(sample)
    return to


def samples(clock=lambda t: t, keep=lambda k: True, seconds=30.0):
    t, q, tau, _ = log(seconds=seconds)
    return [Sample(float(clock(t[k])), q[k], tau[k]) for k in range(len(t)) if keep(k)]


def off(found, clean):
    """Largest distance of two estimates, in standard deviations."""
    return np.abs((found.theta - clean.theta) / clean.std).max()


def adds_up(health):
    return health.received == health.used + sum(getattr(health, x) for x in LEFT_OUT)


@pytest.mark.parametrize("seed", range(3))
def test_a_storm_of_bad_samples_moves_no_estimate_by_its_uncertainty(seed):
    t, q, tau, _ = log()
    found = fed(damaged(t, q, tau, seed=seed))
    assert off(found, after_thirty_seconds()) < 1.0
    assert not found.changes
    health = found.health
    assert adds_up(health) and all(getattr(health, x) > 20 for x in LEFT_OUT)
    assert health.missing > 80 and health.restarts == 0
    assert health.rate == pytest.approx(RATE, rel=0.03)
    assert not health.ok and "are lost" in health.problems[0]


@pytest.mark.parametrize("fault", FAULTS)
def test_no_kind_of_bad_sample_does_harm_by_itself(fault):
    t, q, tau, _ = log()
    found = fed(damaged(t, q, tau, faults=(fault,)))
    assert off(found, after_thirty_seconds()) < 1.0
    assert adds_up(found.health) and not found.changes


def test_one_sample_that_is_not_a_number_is_counted_and_nothing_else():
    stream, clean = samples(seconds=10.0), tracked(log(seconds=10.0))
    bad = stream[1000]
    stream[1000] = Sample(bad.t, np.full(6, np.nan), bad.tau)
    found = fed(stream)
    assert found.health.not_finite == 1 and found.health.missing == 0
    assert off(found, clean) < 0.3 and not found.changes and found.health.ok


def test_three_hundred_missing_samples_are_bridged():
    whole, at, worst = samples(), 4000, {}
    for name, kept in (("gap", whole[:at] + whole[at + 300 :]), ("none", whole)):
        found, errors = tracker(), []
        for sample in kept:
            found.update(sample)
            if sample.t > whole[at + 300].t:
                errors.append(np.abs(found.error).max())
        worst[name] = max(errors)
        if name == "gap":
            bridged = found
    assert worst["gap"] < 1.5 * worst["none"]
    found = bridged
    assert off(found, after_thirty_seconds()) < 1.0 and not found.changes
    assert found.health.missing == 300 and found.health.restarts == 1
    assert found.health.ok and adds_up(found.health)


@pytest.mark.parametrize("step", [3600.0, -10.0, -1e9])
def test_a_clock_that_jumps_is_followed_and_counted(step):
    jumped = samples(clock=lambda t: t + step * (t > 16))
    found = fed(jumped)
    assert off(found, after_thirty_seconds()) < 1.0 and not found.changes
    assert found.health.restarts == 1 and adds_up(found.health)
    assert found.health.received - found.health.used == 10


def test_epoch_time_with_jitter_is_as_good_as_a_perfect_clock():
    rng, (t, q, tau, _) = np.random.default_rng(0), log()
    early = rng.uniform(-0.2, 0.2, len(t)) / RATE
    at = [np.interp(t + early, t, x) for x in q.T]
    found = fed(
        Sample(float(x), *y)
        for x, *y in zip(1.7e9 + t + early, np.array(at).T, tau, strict=True)
    )
    assert off(found, after_thirty_seconds()) < 3.0
    assert found.health.ok and found.health.used == len(t)


@pytest.mark.parametrize("rate", [0.5, 0.9, 1.1, 2.0, 1e-3])
def test_a_wrong_rate_is_noticed(rate):
    found = fed(samples(clock=lambda t: t / rate, seconds=10.0))
    assert not found.health.ok and not found.health.rate_is_right
    assert any("Hz" in problem for problem in found.health.problems)
    if rate > 0.1:
        assert found.health.rate == pytest.approx(rate * RATE, rel=0.01)
    assert np.all(np.isfinite(found.theta)) and not found.changes


def test_the_right_rate_is_no_problem():
    health = after_thirty_seconds().health
    assert health.ok and health.problems == () and health.lost < 1e-12
    assert health == Health(
        received=7501, used=7501, rate=pytest.approx(RATE), stated_rate=RATE
    )
    assert tracker().health == Health(stated_rate=RATE)


def test_a_joint_that_stands_between_two_steps_of_its_encoder_hides_no_other():
    t, q, tau, _ = log(seconds=10.0)
    step, rng = 2 * np.pi / 2**13, np.random.default_rng(0)
    ends = []
    for flips in (np.zeros(len(t)), rng.random(len(t)) < 0.03):
        stands = q.copy()
        stands[:, 5] = q[0, 5] + step * flips
        ends.append(tracked((t, stands, tau, None)))
    first = [k for k, p in enumerate(ends[0].parameters) if "[base]" in p.name]
    assert np.all(ends[1].std[first] < 1.1 * ends[0].std[first])


def test_after_a_bad_first_sample_all_is_well():
    stream, clean = samples(seconds=10.0), tracked(log(seconds=10.0))
    first = Sample(1e9, stream[0].q + 500.0, stream[0].tau)
    found = fed([first, *stream])
    assert found.health.restarts == 1 and off(found, clean) < 0.3


NUMBERS = st.one_of(
    st.floats(-3, 3),
    st.sampled_from([np.nan, np.inf, -np.inf, 1e300, -1e155, 1e20, 5e-324, 1e6]),
)
TIMES = st.one_of(
    st.integers(-3, 30).map(lambda k: k / RATE), st.floats(-1, 1), NUMBERS
)


@cache
def warm():
    return samples(seconds=3.0)[:400]


@settings(max_examples=25, deadline=None)
@given(
    exact=st.booleans(),
    rows=st.lists(
        st.tuples(TIMES, st.lists(NUMBERS, min_size=4, max_size=4)), max_size=60
    ),
)
def test_whatever_comes_the_estimate_stays_finite_and_the_counts_add_up(exact, rows):
    to, t = tracker(), 0.0
    for step, values in rows:
        t = t + step if np.isfinite(step) and abs(t) < 1e300 else step
        q, tau, v, a = (np.full(6, x) * np.linspace(0.5, 1, 6) for x in values)
        to.update(Sample(t, q, tau, v, a) if exact else Sample(t, q, tau))
    for k, s in enumerate(warm()):
        still = np.zeros(6)
        to.update(Sample(s.t, s.q, s.tau, still + k % 2, still) if exact else s)
    assert np.all(np.isfinite(to.theta)) and np.all(np.isfinite(to.std))
    assert np.all(np.isfinite(to.noise)) and np.all(np.isfinite(to.error))
    assert to.health.received == len(rows) + 400 and adds_up(to.health)
    assert 0 <= to.health.lost <= 1 and to.health.used > 100


def test_a_sample_of_the_wrong_shape_is_one_clear_line():
    to = tracker()
    with pytest.raises(IdentificationError, match="6 of each kind, 12 in all"):
        to.update(Sample(0.0, np.zeros(5), np.zeros(6)))
    with pytest.raises(IdentificationError, match="not of numbers"):
        to.update(Sample(0.0, ["a"] * 6, np.zeros(6)))
    exact = tracker()
    exact.update(Sample(0.0, *np.zeros((4, 6))))
    with pytest.raises(IdentificationError, match="every sample must"):
        exact.update(Sample(0.1, *np.zeros((2, 6))))


def test_no_call_does_much_more_than_another():
    t, q, tau, _ = log(seconds=10.0)
    to = OnlineIdentifier(arm(), effects(), rate=1000.0)
    work = np.zeros(600)

    def count(_, event, __):
        work[k] += event in ("call", "c_call")

    for k in range(len(work)):
        sample = Sample(k / 1000, q[k], tau[k])
        sys.setprofile(count)
        try:
            to.update(sample)
        finally:
            sys.setprofile(None)
    usual = work[200:]
    assert usual.max() < 4 * usual.mean()
    assert all(len(share) <= 1 for share in to._shares)


# --- the intake by itself -------------------------------------------------------------


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
        assert np.abs(to.left(powers, q, fitted)).max() < 1e-9
        first = np.arange(len(fitted))[:, None] * group + to.margin
        middle = t[first + np.arange(group)].mean(axis=1) / scale
        for order, found in enumerate(to.states(fitted)):
            exact = np.stack([p.deriv(order)(middle) for p in curve], axis=1)
            np.testing.assert_allclose(
                found * scale**order, exact, rtol=1e-7, atol=1e-7
            )


@pytest.mark.parametrize("late", [0, -1])
def test_a_window_that_lasts_too_long_is_not_whole(late):
    """Its bandwidth would be less than it has to be, wherever the gap is."""
    to = LocalPolynomial(1000.0, 50.0)
    t = np.arange(2 * to.margin + 1) / 1000.0
    assert to.windows(t)[1].all()
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
    assert to.is_spread(left).all()
    left[0, 4, 1] = 100.0
    assert to.is_spread(left).tolist() == [[True, False]]


@pytest.mark.parametrize("block", [1, 4, 10])
def test_a_low_pass_by_blocks_is_the_filter_of_all_samples(block):
    b, a = butter(2, 10.0, fs=500.0)
    x = np.random.default_rng(0).normal(size=(40, 3)) + 5.0
    expected = lfilter(b, a, x, axis=0, zi=np.multiply.outer(lfilter_zi(b, a), x[0]))[0]
    to = BlockLowPass(500.0, 10.0, block)
    found = [to(x[k : k + block]) for k in range(0, 40, block)]
    np.testing.assert_allclose(found, expected[block - 1 :: block], rtol=1e-9)
