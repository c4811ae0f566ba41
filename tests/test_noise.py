"""Noise as a process: whitened samples are those of its whole covariance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import multivariate_normal
from test_evidence import dense, problem

from hybrid.diagnosis.evidence.bayes import heavy_tailed, log_bayes
from hybrid.diagnosis.evidence.noise import (
    LAGS,
    Noise,
    autocovariance,
    floored,
    whitened_power,
)


def covariance(pole, size=2.0, lags=LAGS):
    """Of an autoregression of first order."""
    return size * pole ** np.arange(lags + 1)


SIZES = np.geomspace(0.2, 5.0, 40)  # of 40 samples, over the usual one


@given(pole=st.floats(-0.95, 0.95), hole=st.integers(1, 39), size=st.booleans())
def test_whitened_samples_have_the_covariance_of_white_ones(pole, hole, size):
    follows = np.ones(40, dtype=bool)
    follows[[0, hole]] = False
    noise = Noise(covariance(pole), follows, SIZES if size else 1.0)
    W = noise.whiten(np.eye(40))
    own = toeplitz(covariance(pole, lags=39))
    own[:hole, hole:] = own[hole:, :hole] = 0.0  # nothing is known across a hole
    own *= np.outer(SIZES, SIZES) if size else 1.0
    np.testing.assert_allclose(W @ own @ W.T, np.eye(40), atol=1e-9)


@given(pole=st.floats(-0.95, 0.95), hole=st.integers(1, 39), size=st.booleans())
def test_weighting_is_by_the_inverse_of_the_covariance(pole, hole, size):
    follows = np.ones(40, dtype=bool)
    follows[[0, hole]] = False
    own = toeplitz(covariance(pole, lags=39))
    own[:hole, hole:] = own[hole:, :hole] = 0.0
    own *= np.outer(SIZES, SIZES) if size else 1.0
    weighted = Noise(covariance(pole), follows, SIZES if size else 1.0).weight(own)
    np.testing.assert_allclose(weighted, np.eye(40), atol=1e-8)


@given(pole=st.floats(-0.95, 0.95), other=st.floats(-0.9, 0.9))
def test_the_power_of_a_whitened_process_is_that_of_its_filter(pole, other):
    assert whitened_power(covariance(pole), covariance(pole, 6.0)) == pytest.approx(3.0)
    # An autoregression of first order is whitened by the difference to its forecast.
    by, x = covariance(pole), covariance(other)
    expected = ((1 + pole**2) * x[0] - 2 * pole * x[1]) / (by[0] * (1 - pole**2))
    assert whitened_power(by, x) == pytest.approx(expected)


def test_the_covariance_of_a_long_signal_is_found():
    rng = np.random.default_rng(1)
    x = lfilter([1.0], [1.0, -0.8], rng.standard_normal(200_000))
    found = autocovariance(x, np.arange(len(x)), 4)
    expected = 0.8 ** np.arange(5) / (1 - 0.8**2)
    np.testing.assert_allclose(found, expected, rtol=0.03)


def test_a_stop_band_has_as_much_noise_as_the_upper_half_of_its_band():
    """What a filter took away is no certainty."""
    f = np.linspace(0.0, 0.5, 2001)
    density = np.where(f < 0.1, 1.0, 0.0)
    lags = np.arange(LAGS + 1)
    own = 2 * np.trapezoid(density * np.cos(2 * np.pi * np.outer(lags, f)), f, axis=1)
    more = floored(own, 0.1)
    assert more[0] - own[0] == pytest.approx(1.0, rel=0.35)
    np.testing.assert_array_equal(more[1:], own[1:])


def test_the_evidence_of_coloured_noise_is_that_of_its_covariance():
    gap, blocks, std, evidence, index = problem(2)
    gap.trajectory = np.zeros(len(gap.fold), dtype=int)
    own = [covariance(0.6, 0.7), covariance(-0.3, 1.9)]
    evidence.set_covariances(own)
    X, y, _, prior = dense(gap, blocks, std, evidence.noise)
    C = np.zeros((len(y), len(y)))
    start = 0
    for rows, x in zip(evidence.rows, own, strict=True):
        time = np.sort(rows)
        apart = np.abs(np.subtract.outer(time, time))
        run = np.cumsum((np.diff(time, prepend=-9) != 1)
                        | (np.diff(gap.fold[time], prepend=-1) != 0))  # fmt: skip
        same = np.equal.outer(run, run) & (apart <= LAGS)
        part = slice(start, start + len(time))
        pole = x[1] / x[0]
        C[part, part] = np.where(same, x[0] * np.sign(pole) ** apart
                                 * np.abs(pole) ** apart, 0.0)  # fmt: skip
        start += len(time)
    zero = np.zeros(len(y))
    expected = multivariate_normal(zero, C + X * prior @ X.T).logpdf(y)
    expected -= multivariate_normal(zero, C).logpdf(y)
    found = evidence.solve(np.concatenate(index))
    assert found.evidence == pytest.approx(expected, abs=1e-6)
    left = sum(evidence.weighted_squares(found.index, found.gains))
    fit = y - X @ found.gains
    assert left == pytest.approx(fit @ np.linalg.solve(C, fit))
    for i, rows in enumerate(evidence.rows):
        residual = evidence.residual(i, found.index, found.gains)
        part = X[gap.moving[:, 0].sum() * i :][: len(rows)]
        fitted = part[np.argsort(np.argsort(rows))] @ found.gains
        np.testing.assert_allclose(residual, gap.left[rows, i] - fitted, atol=1e-9)


def test_gains_that_the_prior_holds_are_not_determined_by_samples():
    """Of all gains, the samples of both joints determine what no prior does."""
    *_, evidence, index = problem(2)
    found = evidence.solve(np.concatenate(index))
    held = np.diag(found.covariance) @ evidence.precision[found.index]
    count = sum(evidence.determined(found, i) for i in range(2))
    assert 0.0 < count == pytest.approx(len(found.index) - held)
    evidence.scale_prior(found.index, 1e-6)
    held_fast = evidence.solve(found.index)
    assert sum(evidence.determined(held_fast, i) for i in range(2)) < 1e-3


def test_squares_without_the_samples_are_those_of_the_samples():
    *_, evidence, index = problem(2)
    for chosen in (index[0], np.concatenate(index)):
        found = evidence.solve(chosen)
        squares = [evidence.left_squares(found, i) for i in range(2)]
        expected = evidence.weighted_squares(chosen, found.gains)
        np.testing.assert_allclose(squares, expected, rtol=1e-9)


def test_noise_may_be_weighed_anew():
    gap, *_, evidence, index = problem(5)
    gap.trajectory = np.zeros(len(gap.fold), dtype=int)
    every = np.concatenate(index)
    lower = [np.full(len(index[2]), -np.inf)]

    def found():
        (gain,) = evidence.screen(np.concatenate(index[:2]), index[2:], lower)
        return evidence.solve(every).evidence, gain

    white = found()
    evidence.set_covariances([covariance(0.6), covariance(-0.4)])
    assert not np.any(np.isclose(found(), white))
    evidence.set_covariances(evidence.noise[:, None])
    np.testing.assert_allclose(found(), white)


def test_a_base_without_one_of_its_blocks_is_screened_as_if_it_had_never_been_in():
    *_, evidence, index = problem(4, widths=(2, 1, 3, 2))
    lower = [np.full(len(x), -np.inf) for x in index]
    base, asked = np.concatenate(index[:2]), index[2:]
    fresh = evidence.screen(index[0], asked, lower[2:])
    less = evidence.screen(base, asked, lower[2:], less=index[1])
    np.testing.assert_allclose(less, fresh, atol=1e-9)
    assert not np.allclose(evidence.screen(base, asked, lower[2:]), fresh)


def test_a_gain_far_out_of_its_prior_costs_by_the_decade():
    """A placeholder in a file, by which a gain is a hundred times larger than usual."""
    H, s = np.array([[1e4]]), np.array([1e6])  # 100 ± 0.01
    lower, precision = np.array([-np.inf]), np.array([1.0])
    narrow, _ = log_bayes(H, s, precision, lower)
    worth, gains, wider = heavy_tailed(H, s, precision, lower)
    assert worth - narrow == pytest.approx(0.5e4 - 0.5 - 2 * np.log(100), rel=1e-3)
    assert wider == 100.0 and gains == pytest.approx(100.0, rel=1e-4)
    usual, _, none = heavy_tailed(H, s / 100, precision, lower)
    assert none == 1.0 and usual == log_bayes(H, s / 100, precision, lower)[0]


def test_gains_of_a_law_that_are_all_small_cost_by_the_decade_once():
    """Each of four gains is a tenth of its usual size: three decades are saved."""
    H, s = 1e8 * np.eye(4), np.full(4, 1e7)  # 0.1 ± 1e-4
    lower, precision = np.full(4, -np.inf), np.ones(4)
    usual, _ = log_bayes(H, s, precision, lower)
    worth, _, factor = heavy_tailed(H, s, precision, lower)
    assert factor == 0.1
    less = 4 * np.log(10.0) - np.log(10.0) + 4 * (0.1**2 - 1.0) / 2
    assert worth - usual == pytest.approx(less, rel=1e-3)
