"""Filters and derivatives at their edges: first samples, margins, what is valid."""

import numpy as np
import pytest

from hybrid.recording import Recording
from hybrid.signals import Sampler, motion_from_recording
from hybrid.signals import cutoff as cutoffs
from hybrid.signals.cutoff import choose_cutoff, power_spectrum
from hybrid.signals.filters import (
    _continued,
    butterworth,
    central_difference,
    filter_reach,
)


def record(q, rate, tau=None):
    t = np.arange(len(q)) / rate
    tau = 0 * q if tau is None else tau
    return Recording(t=t, q=q, tau=tau, joints=("a", "b")[: q.shape[1]])


# --- whole signals --------------------------------------------------------------------


@pytest.mark.parametrize("pad", [0, 1, 8, 9, 25])
def test_beyond_its_ends_a_signal_is_reflected_about_them_as_often_as_needed(pad):
    x = np.random.default_rng(0).standard_normal((2, 9))
    odd = np.pad(x, ((0, 0), (pad, pad)), "reflect", reflect_type="odd")
    np.testing.assert_array_equal(_continued(x, pad), odd)


def test_the_gain_is_the_squared_one_of_its_order():
    rate, cutoff = 500.0, 10.0
    t = np.arange(5000) / rate
    for frequency in (4.0, 10.0, 14.0):
        x = np.sin(2 * np.pi * frequency * t)
        y = butterworth(x, rate=rate, cutoff=cutoff)[1000:-1000]
        ratio = np.tan(np.pi * frequency / rate) / np.tan(np.pi * cutoff / rate)
        gain = 1 / (1 + ratio**10)
        basis = x[1000:-1000]
        assert y @ basis / (basis @ basis) == pytest.approx(gain, rel=2e-4)


def test_a_sampler_gives_every_so_manieth_sample_of_the_filter():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(1003, 7, 2)).cumsum(axis=0)
    for cutoff in (3.0, 11.0, 30.0):
        sampler = Sampler.for_rate(300.0, cutoff)
        assert sampler.factor == int(300.0 / (3.5 * cutoff))
        whole = butterworth(x, rate=300.0, cutoff=cutoff)
        # Dropping samples folds what is left above the new Nyquist frequency: 1e-4.
        found = sampler(x)
        scale = np.abs(whole).max()
        np.testing.assert_allclose(found, whole[:: sampler.factor], atol=1e-9 * scale)
        assert found.flags.c_contiguous


@pytest.mark.parametrize(
    "when", [slice(9000, 9100), slice(0, 1), slice(19_999, 20_000)]
)
def test_a_short_event_is_filtered_as_in_the_whole(when):
    x = np.zeros((20_000, 2))
    x[when, 0] = 1.0
    for factor in (1, 5, 8):
        sampler = Sampler(1000.0, 20.0, factor)
        lasting = np.ones((20_000, 2))
        together = sampler(np.concatenate([x, lasting], axis=1))[:, :2]
        np.testing.assert_allclose(sampler(x), together, atol=1e-8)
    assert not Sampler(1000.0, 20.0, 4)(np.zeros((1000, 3))).any()


def test_a_slow_log_is_filtered_below_one_hertz():
    t = np.arange(0.0, 2000.0, 2.0)
    slow, fast = np.sin(2 * np.pi * 0.005 * t), np.sin(2 * np.pi * 0.2 * t)
    inside = slice(100, -100)
    found = Sampler(0.5, 0.05, 1)(slow + fast)
    np.testing.assert_allclose(found[inside], slow[inside], atol=5e-3)


def test_signals_shorter_than_the_filter_keep_their_line():
    for samples in (2, 5, 30):
        x = np.linspace(1.0, 4.0, samples)
        np.testing.assert_allclose(
            butterworth(x, rate=100.0, cutoff=2.0), x, rtol=0, atol=1e-8
        )


@pytest.mark.parametrize(
    "values", [(0.0, 1.0, 1), (1.0, 0.0, 1), (1.0, 1.0, 0), (-1.0, 1.0, 1)]
)
def test_a_sampler_without_rate_cutoff_or_factor_is_refused(values):
    with pytest.raises(ValueError, match="valid are positive"):
        Sampler(*values)


def test_reach_and_margin_are_where_the_weights_have_decayed():
    impulse = np.zeros(8001)
    impulse[4000] = 1.0
    weights = np.abs(butterworth(impulse, rate=1000.0, cutoff=20.0))
    for tolerance in (1e-3, 1e-6):
        reach = filter_reach(0.02, tolerance=tolerance)
        outside = weights[: 4001 - reach].sum() + weights[4000 + reach :].sum()
        nearer = weights[: 4002 - reach].sum() + weights[3999 + reach :].sum()
        assert outside < tolerance / 4 * 1.01 <= nearer * 1.05
    assert Sampler(1000.0, 20.0, 2).margin == filter_reach(0.02, tolerance=1e-6)
    assert Sampler(1000.0, np.inf, 1).margin == 0


def test_nothing_is_filtered_just_below_the_nyquist_frequency():
    x = np.random.default_rng(0).normal(size=500)
    np.testing.assert_array_equal(butterworth(x, rate=100.0, cutoff=49.0), x)
    assert np.any(butterworth(x, rate=100.0, cutoff=48.9) != x)


def test_central_differences_at_the_edges_and_inside():
    x = np.array([0.0, 1.0, 8.0, 27.0, 64.0, 125.0, 216.0])  # cubes
    fine = central_difference(x, rate=2.0)
    np.testing.assert_allclose(fine[2:-2], 2 * 3 * np.array([4.0, 9.0, 16.0]))
    np.testing.assert_allclose(fine[[1, -2]], (x[[2, -1]] - x[[0, -3]]) / 2 * 2.0)
    np.testing.assert_allclose(fine[0], (-3 * x[0] + 4 * x[1] - x[2]) / 2 * 2.0)
    short = central_difference(x[:4], rate=2.0)
    np.testing.assert_allclose(short[1:-1], (x[2:4] - x[:2]) / 2 * 2.0)
    np.testing.assert_allclose(central_difference(x[:5], rate=2.0)[2], 2 * 3 * 4.0)
    both = np.stack([x, 2 * x], axis=1)
    np.testing.assert_allclose(
        central_difference(both, rate=2.0), np.stack([fine, 2 * fine], axis=1)
    )


# --- motions --------------------------------------------------------------------------


def test_a_mask_leaves_out_both_edges_for_as_long_as_the_filter_weighs_a_hundredth():
    t = np.arange(3000) / 500
    log = record(np.sin(t)[:, None], 500.0)
    motion = motion_from_recording(log, cutoff=20.0)
    edge = 4 + filter_reach(20.0 / 500.0, tolerance=0.04)
    inside = np.zeros(3000, dtype=bool)
    inside[edge:-edge] = True
    np.testing.assert_array_equal(motion.mask, inside)
    free = motion_from_recording(log, cutoff=np.inf)
    assert free.mask.sum() == 3000 - 8 and free.mask[4] and not free.mask[3]
    assert motion.rate == pytest.approx(500.0)


@pytest.mark.parametrize("end", [6.0, 12.0])
def test_the_cutoff_is_one_and_a_half_times_where_motion_ends(end):
    rng = np.random.default_rng(0)
    rate, n = 250.0, 15_000
    f = np.fft.rfftfreq(n, 1 / rate)
    spectrum = np.where(f < end, 1.0, 0.0) * np.exp(2j * np.pi * rng.random(len(f)))
    q = np.fft.irfft(spectrum, n)
    q = np.stack([q, np.roll(q, 3000)], axis=1) / np.std(q)
    noisy = q + 1e-3 * rng.normal(size=q.shape)
    # A majority over 2 Hz decides, which adds half of that.
    expected = pytest.approx(1.5 * (end + 1.0), rel=0.08)
    assert choose_cutoff(record(noisy, rate)) == expected
    still = np.column_stack([noisy[:, 0], np.zeros(n)])
    assert choose_cutoff(record(still, rate)) == expected


def test_a_cutoff_stays_between_five_hertz_and_two_fifths_of_the_rate():
    rng = np.random.default_rng(0)
    white = record(rng.normal(size=(5000, 2)), 100.0)
    assert 5.0 <= choose_cutoff(white) <= 40.0
    slow = np.sin(0.5 * np.arange(20_000) / 200)[:, None]
    quiet = record(slow + 1e-2 * rng.normal(size=slow.shape), 200.0)
    assert choose_cutoff(quiet) == 5.0
    for few in (np.zeros((500, 2)), rng.normal(size=(15, 2))):
        assert choose_cutoff(record(few, 100.0)) == pytest.approx(40.0)
    assert choose_cutoff(record(rng.normal(size=(500, 2)), 12.0)) == pytest.approx(4.8)


# --- periods --------------------------------------------------------------------------


def test_a_log_without_noise_ends_where_its_motion_ends():
    t = np.arange(5000) / 250
    q = np.stack([np.sin(2 * np.pi * 3.0 * t), np.sin(2 * np.pi * 2.5 * t)], axis=1)
    assert 5.0 <= choose_cutoff(record(q, 250.0)) < 12.0


def test_nothing_filtered_is_nothing():
    empty = butterworth(np.zeros((0, 2)), rate=100.0, cutoff=5.0)
    assert empty.shape == (0, 2)
    assert Sampler(100.0, 5.0, 3)(np.zeros((0, 2))).shape == (0, 2)


def test_power_is_the_mean_square_of_its_segments_without_linear_trends():
    """The one-sided density of white noise is twice its variance."""
    x = 3.0 * np.random.default_rng(0).normal(size=(40_000, 2))
    power = power_spectrum(x, 256)
    np.testing.assert_allclose(power_spectrum(2.0 * x, 256), 4.0 * power, rtol=1e-9)
    assert power[8:-8].mean(axis=0) == pytest.approx(18.0, rel=0.03)
    sloped = x + np.outer(np.arange(40_000.0), [3.0, -50.0]) + 200.0
    np.testing.assert_allclose(power_spectrum(sloped, 256)[1:], power[1:], rtol=1e-6)


def chosen(monkeypatch, level, *, rate=100.0, joints=1):
    """The cut-off by a power spectrum that is stated, a function of frequency."""

    def power(q, size):
        assert size / rate == pytest.approx(4.0, abs=0.02)
        f = np.fft.rfftfreq(size, 1 / rate)
        return np.stack([level(f, j) for j in range(joints)], axis=1)

    monkeypatch.setattr(cutoffs, "power_spectrum", power)
    q = np.random.default_rng(0).normal(size=(int(5 * rate), joints))
    return choose_cutoff(record(q, rate))


@pytest.mark.parametrize(("times", "end"), [(30.5, 20.0), (29.5, 10.0)])
def test_motion_is_thirty_times_the_noise_above_three_tenths_of_the_rate(
    monkeypatch, times, end
):
    """The median there; what is beyond 0.45 of the rate does not count."""

    def level(f, _):
        noise = np.where((f > 30.0) & (f < 45.0), 1.0, 7.0)
        noise[(f > 31.0) & (f < 37.0)] = 1e9
        return np.select([f < 10.0, f < 20.0, f < 30.0], [1e6, times, 1.0], noise)

    # A majority over 2 Hz decides: where half of them are below.
    assert chosen(monkeypatch, level) == pytest.approx(1.5 * end, abs=0.6)


@pytest.mark.parametrize(("times", "end"), [(3.05e-13, 20.0), (2.95e-13, 10.0)])
def test_without_noise_the_floor_is_far_below_the_peak(monkeypatch, times, end):
    def level(f, _):
        return np.select([f < 2.0, f < 10.0, f < 20.0], [1.0, 0.5, times], 0.0)

    assert chosen(monkeypatch, level) == pytest.approx(1.5 * end, abs=0.6)


def test_the_median_joint_decides():
    with pytest.MonkeyPatch.context() as patched:
        found = chosen(
            patched, lambda f, j: np.where(f < (8.0, 14.0)[j], 1e6, 1.0), joints=2
        )
    assert found == pytest.approx(1.5 * 11.0, abs=0.6)
