"""Periodic motions of the experiments: their series and their averages."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from periodic import average_periods, fourier_fit

from hybrid.recording import Recording


@settings(max_examples=25)
@given(seed=st.integers(0, 999), order=st.integers(1, 6))
def test_a_fourier_series_is_found_again_with_its_derivatives(seed, order):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 12, 400))
    coefficients = rng.standard_normal((2 * order + 1, 2))
    w = 2 * np.pi * 0.1 * np.arange(1, order + 1)
    phase = np.outer(t, w)
    basis = np.hstack([np.ones((400, 1)), np.sin(phase), np.cos(phase)])
    motion = fourier_fit(t, basis @ coefficients, fundamental=0.1, order=order)
    assert motion.order == order
    assert np.allclose(motion.sine, coefficients[1 : order + 1], atol=1e-6)
    h = 1e-4
    ahead, behind = motion.position(t + h), motion.position(t - h)
    assert np.allclose(motion.velocity(t), (ahead - behind) / (2 * h), atol=1e-4)
    turn = (ahead - 2 * motion.position(t) + behind) / h**2
    assert np.allclose(motion.acceleration(t), turn, atol=1e-4)


@pytest.mark.parametrize("rate", [100.0, 99.7])
def test_averaging_periods_finds_motion_and_noise(rate):
    rng = np.random.default_rng(3)
    t = np.arange(int(40 * rate)) / rate
    q = np.sin(2 * np.pi * 0.25 * t)[:, None] * [1.0, 2.0]
    tau = np.cos(2 * np.pi * 0.25 * t)[:, None] * [5.0, 1.0]
    noise = np.array([0.5, 0.02])
    log = Recording(t=t, q=q, tau=tau + noise * rng.standard_normal(tau.shape))
    mean, std = average_periods(log, 0.25)
    assert mean.size == 2
    assert len(mean.t) == round(rate * 4)
    assert np.allclose(mean.q[:, 0], np.sin(2 * np.pi * 0.25 * mean.t), atol=1e-3)
    # linear interpolation between samples takes up to a third of the noise variance
    assert np.all((std > 0.75 * noise) & (std < 1.1 * noise))
    error = np.std(mean.tau[:, 0] - 5 * np.cos(2 * np.pi * 0.25 * mean.t))
    assert error < 1.3 * noise[0] / np.sqrt(10)
    if rate == 100.0:
        assert std == pytest.approx(noise, rel=0.05)
