"""Filters leave what is slow and take what is fast, without delay and without edges."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfiltfilt

from hybrid.errors import HybridWarning
from hybrid.recording import Recording, read_all
from hybrid.signals import (
    Motion,
    Sampler,
    butterworth,
    central_difference,
    choose_cutoff,
    motion_from_recording,
    speed_against_position,
)
from hybrid.signals.filters import filter_reach

DATA = Path(__file__).parents[2] / "shared" / "data"
RATE = 500.0


def swing(duration: float = 10.0, rate: float = RATE, noise: float = 0.0) -> Recording:
    """Two joints on sums of slow sines, torque with noise."""
    rng = np.random.default_rng(0)
    t = np.arange(int(duration * rate)) / rate
    q = np.stack(
        [np.sin(2 * t) + 0.3 * np.sin(7 * t), np.cos(3 * t) - 0.2 * np.sin(11 * t)], 1
    )
    return Recording(
        t=t, q=q + noise * rng.standard_normal(q.shape), tau=rng.normal(size=q.shape)
    )


def test_the_filter_is_that_of_second_order_sections_run_both_ways():
    x = np.random.default_rng(0).standard_normal((4000, 2))
    for cutoff in (10.0, 60.0, 200.0):
        sections = butter(5, cutoff, fs=RATE, output="sos")
        expected = sosfiltfilt(sections, x, axis=0)
        found = butterworth(x, rate=RATE, cutoff=cutoff)
        assert np.allclose(found[600:-600], expected[600:-600], atol=1e-9)


@pytest.mark.parametrize(("ratio", "gain"), [(0.1, 1.0), (1.0, 0.5), (4.0, 0.0)])
def test_a_sine_keeps_its_phase_and_loses_amplitude_above_the_cutoff(ratio, gain):
    t = np.arange(8000) / RATE
    x = np.sin(2 * np.pi * 10 * ratio * t)
    y = butterworth(x, rate=RATE, cutoff=10.0)
    assert np.allclose(y[1000:-1000], gain * x[1000:-1000], atol=2e-6)


@pytest.mark.parametrize("samples", [2, 3, 50, 1000])
def test_constants_and_straight_lines_pass_up_to_the_edges(samples):
    t = np.arange(samples) / RATE
    line = np.stack([np.full(samples, 3.0), 1 - 2 * t], axis=1)
    assert np.allclose(butterworth(line, rate=RATE, cutoff=5.0), line, atol=1e-6)


@pytest.mark.parametrize("cutoff", [np.inf, 0.99 * RATE / 2, RATE])
def test_nothing_is_filtered_from_the_nyquist_frequency_on(cutoff):
    x = np.random.default_rng(0).standard_normal((100, 2))
    assert np.array_equal(butterworth(x, rate=RATE, cutoff=cutoff), x)
    sampler = Sampler.for_rate(RATE, cutoff)
    assert (sampler.factor, sampler.margin) == (1, 0)


@pytest.mark.parametrize("cutoff", [0.0, -1.0, np.nan])
def test_a_cutoff_that_is_not_positive_is_refused(cutoff):
    with pytest.raises(ValueError, match="positive"):
        butterworth(np.zeros(9), rate=RATE, cutoff=cutoff)
    with pytest.raises(ValueError, match="positive"):
        Sampler(rate=RATE, cutoff=cutoff, factor=1)


@pytest.mark.parametrize("axis", [0, 1, 2, -1])
def test_time_may_lie_along_any_axis(axis):
    x = np.random.default_rng(0).standard_normal((2, 3, 700))
    expected = Sampler(RATE, 20.0, 3)(x, axis=-1)
    moved = Sampler(RATE, 20.0, 3)(np.moveaxis(x, -1, axis), axis=axis)
    assert np.array_equal(np.moveaxis(moved, axis, -1), expected)
    assert moved.flags.c_contiguous
    assert expected.shape == (2, 3, 234)


def test_decimation_keeps_every_factor_th_sample_of_signal_and_mask():
    x = np.random.default_rng(0).standard_normal(1001)
    sampler = Sampler(RATE, 20.0, 4)
    smooth = butterworth(x, rate=RATE, cutoff=20.0)
    # Samples are dropped in the frequency domain, with what folds over.
    np.testing.assert_allclose(sampler(x), smooth[::4], atol=1e-8)
    assert np.array_equal(sampler.keep(x > 0), (x > 0)[::4])
    assert len(sampler.keep(x > 0)) == len(sampler(x)) == 251


@given(rate=st.floats(50, 5000), cutoff=st.floats(1, 1000))
def test_decimation_keeps_samples_enough_for_the_band(rate, cutoff):
    sampler = Sampler.for_rate(rate, cutoff)
    assert sampler.factor >= 1
    if sampler.factor > 1:
        assert rate / sampler.factor >= 3.5 * cutoff * (1 - 1e-9)
    assert rate / (sampler.factor + 1) < 3.5 * cutoff


@pytest.mark.parametrize("cutoff", [4.0, 9.3, 21.0])
def test_what_decimation_folds_into_the_band_was_filtered_before(cutoff):
    sampler = Sampler.for_rate(RATE, cutoff)
    assert sampler.factor > 1
    t = np.arange(20_000) / RATE
    for inside in (0.2, 0.6, 1.0):  # of the band
        alias = RATE / sampler.factor - inside * cutoff
        folded = sampler(np.sin(2 * np.pi * alias * t))[200:-200]
        assert np.abs(folded).max() < 2e-4


@settings(max_examples=25)
@given(
    cutoff=st.sampled_from([8.0, 20.0, 90.0]),
    chunk=st.integers(300, 2000),
    seed=st.integers(0, 99),
)
def test_overlapping_chunks_give_what_the_whole_gives(cutoff, chunk, seed):
    x = np.random.default_rng(seed).standard_normal((6000, 2)) + 3.0
    sampler = Sampler.for_rate(RATE, cutoff)
    k = sampler.factor
    margin = -(-sampler.margin // k) * k
    chunk = -(-chunk // k) * k
    pieces = []
    for start in range(0, len(x), chunk):
        first = max(0, start - margin)
        y = sampler(x[first : start + chunk + margin])
        pieces.append(y[(start - first) // k :][: -(-min(chunk, len(x) - start) // k)])
    whole = sampler(x)
    joined = np.concatenate(pieces)
    assert joined.shape == whole.shape
    assert np.max(np.abs(joined - whole)) <= 1e-6 * np.max(np.abs(x))


def test_what_lies_beyond_the_margin_is_not_felt():
    sampler = Sampler(RATE, 15.0, 1)
    pulse = np.zeros(4001)
    pulse[2000] = 1.0
    response = np.abs(sampler(pulse))
    outside = np.r_[
        response[: 2000 - sampler.margin], response[2001 + sampler.margin :]
    ]
    assert outside.sum() < 1e-6
    assert response[2000 - sampler.margin // 2] > 1e-6  # and it is not far too wide


@given(
    begin=st.integers(0, 1999),
    length=st.integers(0, 500),
    rate=st.sampled_from([200.0, 1000.0]),
)
def test_what_happens_for_a_while_is_filtered_as_if_it_were_beside_what_lasts(
    begin, length, rate
):
    """Silence is not filtered; a signal without any is, and so is its sum with one."""
    x, steady = np.zeros((2000, 2)), 1.0 + np.arange(2000.0)[:, None]
    x[begin : begin + length] = np.random.default_rng(begin).normal(size=2)
    sampler = Sampler.for_rate(rate, 20.0)
    apart = sampler(x + steady) - sampler(np.broadcast_to(steady, x.shape))
    np.testing.assert_allclose(sampler(x), apart, atol=1e-7)


def test_filter_reach_grows_as_the_cutoff_falls():
    assert filter_reach(0.01) == pytest.approx(10 * filter_reach(0.1), rel=0.1)
    assert filter_reach(0.01, tolerance=1e-2) < filter_reach(0.01)


@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-5, 5))
def test_differences_are_exact_on_parabolas(a, b, c):
    t = np.arange(30) / RATE
    x = a + b * t + c * t**2
    v = central_difference(x, rate=RATE)
    assert np.allclose(v, b + 2 * c * t, atol=1e-9)


def test_errors_of_differences_fall_with_their_order():
    def error(samples: int) -> float:
        t = np.linspace(0, 1, samples)
        v = central_difference(np.sin(5 * t), rate=samples - 1.0)
        return float(np.abs(v - 5 * np.cos(5 * t))[2:-2].max())

    assert error(101) / error(201) == pytest.approx(2.0**4, rel=0.1)


def test_motion_has_the_derivatives_of_the_true_motion_where_its_mask_is_true():
    recording = swing()
    motion = motion_from_recording(recording, cutoff=20.0)
    t = recording.t
    v = 2 * np.cos(2 * t) + 2.1 * np.cos(7 * t)
    a = -4 * np.sin(2 * t) - 14.7 * np.sin(7 * t)
    assert motion.rate == pytest.approx(RATE)
    assert 0.9 < motion.mask.mean() < 1.0
    assert not motion.mask[0]
    assert not motion.mask[-1]
    assert np.allclose(motion.q[motion.mask], recording.q[motion.mask], atol=1e-3)
    assert np.allclose(motion.v[motion.mask, 0], v[motion.mask], atol=0.01)
    assert np.allclose(motion.a[motion.mask, 0], a[motion.mask], atol=0.1)
    assert np.array_equal(motion.tau, recording.tau)


def measured(noise: float = 1e-4, **speed: float) -> tuple[Recording, np.ndarray]:
    """A noisy log with a speed that is scaled, late and noisy, and the true speed."""
    log, t = swing(duration=20.0, noise=noise), np.arange(int(20 * RATE)) / RATE
    late = t - speed.get("lag", 0.0)
    v = np.stack(
        [
            2 * np.cos(2 * late) + 2.1 * np.cos(7 * late),
            -3 * np.sin(3 * late) - 2.2 * np.cos(11 * late),
        ],
        axis=1,
    )
    rng = np.random.default_rng(1)
    v = speed.get("scale", 1.0) * v + speed.get("noise", 1e-3) * rng.normal(
        size=v.shape
    )
    true = motion_from_recording(swing(duration=20.0), cutoff=np.inf).v
    return replace(log, v=v), true


def without_speed(log: Recording, cutoff: float | None = None) -> Motion:
    return motion_from_recording(replace(log, v=None), cutoff=cutoff)


@pytest.mark.parametrize("speed", [{}, {"lag": 0.004}, {"lag": -0.003, "scale": 0.98}])
def test_a_measured_speed_of_little_noise_makes_the_motion_better(speed):
    log, true = measured(**speed)
    # Differences of the positions have seventy times its noise: it counts alone.
    assert speed_against_position(log).weight.max(axis=0) == pytest.approx(1, abs=0.05)
    fused, plain = motion_from_recording(log, cutoff=20.0), without_speed(log, 20.0)
    for order in ("v", "a"):
        mask, x = fused.mask, true
        if order == "a":
            x = central_difference(true, rate=RATE)
        left, before = (getattr(m, order)[mask] - x[mask] for m in (fused, plain))
        assert np.all(left.std(axis=0) < 0.5 * before.std(axis=0))
    # One motion: speed and acceleration are its derivatives.
    assert np.array_equal(fused.v, central_difference(fused.q, rate=RATE))
    assert np.array_equal(fused.a, central_difference(fused.v, rate=RATE))
    assert np.abs(fused.q - plain.q).max() < 4e-4  # by no more than their noise


def test_scale_and_lag_of_a_measured_speed_are_found():
    check = speed_against_position(measured(lag=0.004, scale=0.9)[0])
    assert np.all(np.abs(check.scale - 0.9) < 4e-3)
    assert check.lag == pytest.approx(0.004, abs=1e-4)
    assert np.all(check.coherence > 0.99)
    assert np.all(check.same_noise < 0.5)
    backward = speed_against_position(measured(scale=-1.0)[0])
    assert backward.scale == pytest.approx(-1.0, abs=0.01)
    assert not backward.weight.any()


@pytest.mark.parametrize("seconds", [2.0, 3.0])
def test_of_a_short_log_without_noise_scale_and_lag_are_exact(seconds):
    t, lag = np.arange(0.0, seconds + 1e-9, 0.01), 0.04
    q = np.sin(6 * t) + 0.3 * np.cos(11 * t + 0.3)
    late = 6 * np.cos(6 * (t - lag)) - 3.3 * np.sin(11 * (t - lag) + 0.3)
    log = Recording(t, q[:, None], tau=0 * q[:, None], v=late[:, None], joints=("a",))
    check = speed_against_position(log)
    assert check.lag == pytest.approx(lag, rel=1e-3)
    assert check.scale == pytest.approx(1.0, abs=1e-3)


def stops(v: np.ndarray, first: int, last: int) -> np.ndarray:
    """The same, but zero for a while."""
    v = v.copy()
    v[first:last] = 0.0
    return v


@pytest.mark.parametrize(
    "spoil",
    [
        pytest.param(lambda v, q: np.ones_like(v), id="constant"),
        pytest.param(lambda v, q: np.zeros_like(v), id="zero"),
        pytest.param(lambda v, q: 0.9 * v, id="a tenth too slow"),
        pytest.param(lambda v, q: -v, id="backward"),
        pytest.param(lambda v, q: np.degrees(v), id="degrees"),
        pytest.param(lambda v, q: v[:, ::-1], id="of the other joint"),
        pytest.param(lambda v, q: stops(v, 4000, 4200), id="stops for a while"),
        pytest.param(lambda v, q: stops(v, 9700, 10_000), id="stops at the end"),
        pytest.param(
            lambda v, q: np.random.default_rng(0).normal(size=v.shape), id="noise"
        ),
    ],
)
def test_a_speed_that_is_none_changes_nothing(spoil):
    log, _ = measured()
    spoilt = replace(log, v=spoil(log.v, log.q))
    fused, plain = motion_from_recording(spoilt), without_speed(spoilt)
    assert np.array_equal(fused.q, plain.q)
    assert np.array_equal(fused.a, plain.a)


def test_a_speed_that_was_computed_from_the_positions_adds_nothing():
    log, true = measured()
    backward = np.diff(log.q, axis=0, prepend=log.q[:1]) * RATE
    computed = replace(log, v=backward)
    assert np.all(speed_against_position(computed).same_noise > 0.9)
    fused, plain = motion_from_recording(computed), without_speed(computed)
    change = (fused.v - plain.v)[plain.mask].std(axis=0)
    assert np.all(change < 0.02 * (plain.v - true)[plain.mask].std(axis=0))


def test_a_filtered_speed_is_not_followed_where_it_loses_motion():
    log, true = measured(noise=1e-5)
    slow = lfilter([1 - 0.94], [1, -0.94], log.v, axis=0)  # 5 Hz, 31 ms late
    log = replace(log, v=slow)
    fused, plain = motion_from_recording(log), without_speed(log)
    errors = [np.std((m.v - true)[m.mask], axis=0) for m in (fused, plain)]
    assert np.all(errors[0] < 1.03 * errors[1])


def test_each_joint_is_judged_on_its_own():
    log, _ = measured()
    half = replace(log, v=log.v * [1.0, 0.0])
    still = replace(log, q=log.q * [1.0, 0.0], v=half.v)
    for spoilt in (half, still):
        moved = motion_from_recording(spoilt).q != without_speed(spoilt).q
        assert moved[:, 0].any()
        assert not moved[:, 1].any()
    none, zero = speed_against_position(still), speed_against_position(half)
    assert np.isnan([none.scale[1], none.lag[1], none.coherence[1]]).all()
    assert zero.scale[1] == zero.coherence[1] == 0.0


@pytest.mark.parametrize("samples", [2, 20, 70, 500])
def test_a_short_log_keeps_its_positions_or_is_corrected_within_their_noise(samples):
    log, _ = measured()
    short = replace(
        log, t=log.t[:samples], q=log.q[:samples], v=log.v[:samples],
        tau=log.tau[:samples],
    )  # fmt: skip
    check = speed_against_position(short)
    assert check.weight.shape == (len(check.frequency), 2)
    assert np.isfinite(check.weight).all()
    if samples > 5:
        fused, plain = (
            f(short, cutoff=20.0) for f in (motion_from_recording, without_speed)
        )
        assert np.abs(fused.q - plain.q).max() < 4e-4


def test_motion_of_an_irregular_clock_is_on_a_uniform_one():
    recording = swing()
    t = recording.t + 0.0004 * np.sin(np.arange(len(recording.t)))
    with pytest.warns(HybridWarning, match="irregular clock"):
        motion = motion_from_recording(Recording(t=t, q=recording.q, tau=recording.tau))
    assert np.ptp(np.diff(motion.t)) < 1e-9


def test_a_recording_shorter_than_its_filter_has_no_usable_sample():
    motion = motion_from_recording(swing(duration=0.1), cutoff=5.0)
    assert not motion.mask.any()
    assert np.isfinite(motion.a).all()


@pytest.mark.parametrize("rate", [50.0, 125.0, 1000.0])
def test_the_cutoff_falls_as_noise_rises(rate):
    cutoffs = [
        choose_cutoff(swing(rate=rate, noise=noise)) for noise in (0.0, 1e-5, 1e-3)
    ]
    assert cutoffs == sorted(cutoffs, reverse=True)
    assert all(5.0 <= cutoff <= 0.4 * rate for cutoff in cutoffs)
    assert cutoffs[-1] < 15.0


@pytest.mark.parametrize("duration", [1.0, 3.0, 30.0])
def test_a_cutoff_is_found_for_short_still_and_stepped_logs(duration):
    recording = swing(duration=duration)
    for q in (recording.q * 0, np.round(recording.q, 3), np.sign(recording.q)):
        cutoff = choose_cutoff(Recording(t=recording.t, q=q, tau=recording.tau))
        assert 5.0 <= cutoff <= 0.4 * RATE + 1e-6


def test_the_chosen_cutoff_makes_acceleration_better_than_none():
    recording = swing(noise=1e-4)
    t = recording.t
    a = -4 * np.sin(2 * t) - 14.7 * np.sin(7 * t)

    def error(cutoff: float | None) -> float:
        motion = motion_from_recording(recording, cutoff=cutoff)
        return float(np.std((motion.a[:, 0] - a)[motion.mask]))

    assert error(None) < 0.2
    assert error(None) < 0.1 * error(40.0) < 0.1 * error(np.inf)


@pytest.mark.parametrize(
    ("folder", "lowest", "highest"),
    [
        ("ur10_salerno", 5, 15),
        ("kr300_kaiserslautern", 10, 40),
        ("tx40_figaroh", 40, 150),
    ],
)
@pytest.mark.filterwarnings("ignore::hybrid.errors.HybridWarning")
def test_the_cutoff_of_real_logs_is_sane(folder, lowest, highest):
    if not (DATA / folder).is_dir():
        pytest.skip(f"the real logs are not here: no {DATA / folder}")
    for recording in read_all(DATA / folder):
        assert lowest <= choose_cutoff(recording) <= highest


@pytest.mark.parametrize("scale", [0.955, 1.045])
def test_a_speed_counts_by_its_noise_in_units_of_the_position(scale):
    """A speed that is off by a factor has its noise off by it, and counts the same.

    The noise of speeds is far above that of positions, so all is in proportion.
    """
    log = swing(duration=20.0, noise=1e-5)
    v = central_difference(log.q, rate=RATE)
    log = replace(log, v=v + 0.3 * np.random.default_rng(1).normal(size=v.shape))
    same, other = (
        speed_against_position(replace(log, v=k * log.v)).weight for k in (1.0, scale)
    )
    used = (same > 0) & (other > 0)
    assert used.sum() > 100
    np.testing.assert_allclose(other[used], same[used], rtol=0.01)
