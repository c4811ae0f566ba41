"""A measured speed beside positions: spectra, weights and corrections by formula."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import csd

from hybrid.recording import Recording
from hybrid.signals.filters import butterworth, butterworth_gain
from hybrid.signals.speed import (
    SpeedCheck,
    _advanced,
    _compare,
    _densities,
    _moving_band,
    _smooth,
    correction_by_speed,
    speed_against_position,
)

RATE = 100.0


def noise(count, seed=0, joints=2):
    return np.random.default_rng(seed).normal(size=(count, joints))


def test_a_mean_over_a_band_is_that_of_the_frequencies_within_a_fifth():
    f, x = np.arange(1.0, 60.0), noise(59)
    found = _smooth(f, x)
    for k, centre in enumerate(f):
        near = (f >= centre / 1.2) & (f <= 1.2 * centre)
        np.testing.assert_allclose(found[k], x[near].mean(axis=0))


@pytest.mark.parametrize("size", [80, 81])
def test_an_arm_may_move_from_above_zero_to_the_end_of_the_noise_band(size):
    every = np.fft.rfftfreq(size, 1 / RATE)
    below = every[(every > 0) & (every < 0.45 * RATE - 1e-9)]
    np.testing.assert_allclose(_moving_band(size, RATE), below)


@pytest.mark.parametrize("count", [400, 1000, 137])
def test_densities_are_those_of_welch_with_four_seconds_a_segment(count):
    """Of a derivative and its own derivative, without what differences lose."""
    u, v = noise(count, 1).cumsum(axis=0), noise(count, 2)
    size = min(count, 400)
    f, found = _densities(u, v, RATE)
    a = np.gradient(u, axis=0) * RATE
    lost = np.sinc(2 * f / RATE)[:, None]
    signals = {"u": (u, lost), "a": (a, lost**2), "v": (v, 1.0)}
    pairs = "uu", "vv", "uv", "aa", "av", "au"
    for (one, two), density in zip(pairs, found, strict=True):
        (x, x_lost), (y, y_lost) = signals[one], signals[two]
        every, expected = csd(x, y, RATE, "blackmanharris", size, size // 2, axis=0)
        kept = (every > 0) & (every < 0.45 * RATE - 1e-9)
        np.testing.assert_allclose(every[kept], f)
        expected = expected[kept] / x_lost / y_lost
        scale = np.abs(expected).max()
        np.testing.assert_allclose(density, expected, rtol=1e-6, atol=1e-12 * scale)


def test_signals_are_advanced_each_by_its_own_lag_beyond_their_ends():
    """Where they go on by their point reflection: a line stays one."""
    t = np.arange(300) / RATE
    lag = np.array([0.05, -0.03])
    waves = np.stack([np.sin(5 * t), np.cos(3 * t)], axis=1)
    found = _advanced(waves, lag, RATE)
    np.testing.assert_allclose(found[:-5, 0], waves[5:, 0], atol=5e-3)
    np.testing.assert_allclose(found[3:, 1], waves[:-3, 1], atol=5e-3)
    line = _advanced(np.stack([2.0 * t, 7.0 - t], axis=1), lag, RATE)
    exact = np.stack([2.0 * (t + 0.05), 7.0 - (t - 0.03)], axis=1)
    np.testing.assert_allclose(line, exact, atol=5e-3)


def swinging(count=2000, *, late=0.0, scale=1.0, hum=1e-2, jitter=1e-5):
    """Two joints, each of two tones, and their measured speeds."""
    t, w = np.arange(count) / RATE, np.array([[2.0, 7.0], [3.0, 11.0]])[:, :, None]
    q = np.stack([np.sin(x * t).sum(axis=0) for x in w], axis=1)
    v = np.stack([(x * np.cos(x * (t - late))).sum(axis=0) for x in w], axis=1)
    return Recording(
        t, q + jitter * noise(count), v=scale * v + hum * noise(count, 1),
        tau=0 * q, joints=("a", "b"),
    )  # fmt: skip


def test_a_comparison_is_weighted_by_the_noise_of_both():
    """Least squares of v on u and its derivative; weights by what differs."""
    log = swinging(scale=0.98, late=0.002, jitter=1e-4)
    u = np.gradient(log.q, axis=0) * RATE
    found = _compare(u, log.v, RATE)
    f, every = _densities(u, log.v, RATE)
    uu, vv, uv, aa, av, au = (x.real for x in every)
    omega, band = 2 * np.pi * f[:, None], f > 0.3 * RATE - 0.2
    alike = np.mean((np.abs(every[2]) ** 2 / (uu * vv))[band], axis=0)
    np.testing.assert_allclose(found.same_noise, alike, rtol=1e-9)
    white = (1 - alike) * np.median((uu / omega**2)[band], axis=0)
    np.testing.assert_allclose(found.noise, white, rtol=1e-9)
    hum = np.median(vv[band], axis=0)
    weight = (uu > 2 * omega**2 * white) / (omega**2 * white + hum)
    for j in range(2):
        w = weight[:, j]
        sums = {k: w @ x[:, j] for k, x in zip(
            ("uu", "vv", "uv", "aa", "av", "au"), (uu, vv, uv, aa, av, au), strict=True
        )}  # fmt: skip
        left = np.array([[sums["uu"], -sums["au"]], [-sums["au"], sums["aa"]]])
        scale, late = np.linalg.solve(left, [sums["uv"], -sums["av"]])
        assert found.lag[j] == pytest.approx(late / scale, rel=1e-6)
        signal = w * np.maximum(uu[:, j] - (omega**2 * white)[:, j], 0.0)
        scale = sums["uv"] / signal.sum()
        assert found.scale[j] == pytest.approx(scale, rel=1e-9)
        off = np.maximum(vv[:, j] / scale**2 + uu[:, j] - 2 * uv[:, j] / scale, 0.0)
        like = sums["uv"] ** 2 / sums["uu"] / sums["vv"]
        assert found.coherence[j] == pytest.approx(like, rel=1e-9)
        position = (omega**2 * white)[:, j]
        other = np.maximum(_smooth(f, off[:, None])[:, 0] - position, hum[j] / scale**2)
        gain = position / (position + other)
        np.testing.assert_allclose(found.weight[:, j], gain, rtol=1e-6)


@pytest.mark.parametrize(
    ("scale", "used"), [(0.94, False), (0.96, True), (1.04, True), (1.06, False)]
)
def test_a_speed_that_is_off_by_a_twentieth_is_not_used(scale, used):
    check = speed_against_position(swinging(scale=scale))
    assert check.scale == pytest.approx([scale] * 2, abs=2e-3)
    assert check.weight.any(axis=0).tolist() == [used, used]


@pytest.mark.parametrize(("share", "used"), [(0.36, False), (0.31, True)])
def test_a_speed_that_is_coherent_by_nine_tenths_is_used(share, used):
    """What is not coherent has the spectrum of the motion, a share of its size."""
    rng, count = np.random.default_rng(0), 6000
    own, other = (
        butterworth(rng.normal(size=(count, 1)), rate=RATE, cutoff=4.0)
        for _ in range(2)
    )
    q = np.cumsum(own, axis=0) / RATE
    v = np.gradient(q, axis=0) * RATE
    log = Recording(
        np.arange(count) / RATE, q, v=v + share * other + 1e-6 * noise(count, 3, 1),
        tau=0 * q, joints=("a",),
    )  # fmt: skip
    check = speed_against_position(log)
    assert check.coherence == pytest.approx(1 / (1 + share**2), abs=0.02)
    assert check.weight.any() == used


@pytest.mark.parametrize(("samples", "told"), [(63, False), (64, True)])
def test_a_spectrum_takes_sixty_four_samples(samples, told):
    log = swinging(samples)
    check = speed_against_position(log)
    assert np.isfinite(check.scale).all() == told
    assert np.isfinite(check.noise).all() == told
    if not told:
        assert not check.weight.any() and check.weight.shape == (1, 2)


@pytest.mark.parametrize("late", [0.03, -0.045])
def test_a_lag_is_exact_and_a_longer_one_than_a_twentieth_is_not_sought(late):
    check = speed_against_position(swinging(late=late, hum=1e-4))
    assert check.lag == pytest.approx([late] * 2, abs=1e-4)
    far = speed_against_position(swinging(late=2 * late, hum=1e-4))
    assert far.lag == pytest.approx([np.sign(late) * 0.05] * 2)


def drifting(*, late=0.0, scale=1.0, size=1e-3):
    """A joint whose positions err by a slow wave, and a check of its exact speed."""
    t = np.arange(2000) / RATE
    error = size * np.sin(2 * np.pi * 1.5 * t)
    log = Recording(
        t, (np.sin(2.0 * t) + error)[:, None],
        v=scale * 2.0 * np.cos(2.0 * (t - late))[:, None], tau=0 * t[:, None],
        joints=("a",),
    )  # fmt: skip
    one, f = np.ones(1), np.arange(0.25, 45.0, 0.25)
    weight = np.full((len(f), 1), 0.5)
    check = SpeedCheck(scale * one, late * one, one, 0 * one, one, f, weight)
    return log, check, error


@pytest.mark.parametrize(
    ("late", "scale"), [(0.0, 1.0), (0.02, 1.0), (0.0, 2.0), (-0.015, 0.5)]
)
def test_a_speed_takes_its_share_of_what_positions_err_by(late, scale):
    log, check, error = drifting(late=late, scale=scale)
    mask = np.ones(2000, dtype=bool)
    found = correction_by_speed(log, cutoff=np.inf, mask=mask, check=check)[:, 0]
    inner = slice(200, -200)
    np.testing.assert_allclose(found[inner], -0.5 * error[inner], atol=5e-5)
    filtered = correction_by_speed(log, cutoff=1.5, mask=mask, check=check)[:, 0]
    np.testing.assert_allclose(filtered[inner], -0.25 * error[inner], atol=5e-5)


@pytest.mark.parametrize(("times", "kept"), [(7.9, True), (8.1, False)])
def test_a_correction_of_eight_deviations_of_noise_contradicts(times, kept):
    """The variance is the integral of the noise that the weight lets through."""
    log, check, _ = drifting()
    mask = np.zeros(2000, dtype=bool)
    mask[200:-200] = True
    found = correction_by_speed(log, cutoff=10.0, mask=mask, check=check)
    largest = np.abs(found[mask]).max()
    assert largest == pytest.approx(5e-4, rel=0.05)
    f = np.linspace(0.0, 45.0, 100_001)
    passed = butterworth_gain(f, rate=RATE, cutoff=10.0)
    through = np.trapezoid(0.5 * passed**2, f)  # of the weight once, as it is optimal
    least = replace(check, noise=np.array([(largest / times) ** 2 / through]))
    again = correction_by_speed(log, cutoff=10.0, mask=mask, check=least)
    assert again.any() == kept
    none = replace(check, weight=0 * check.weight)
    assert not correction_by_speed(log, cutoff=10.0, mask=mask, check=none).any()
