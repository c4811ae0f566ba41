"""Check a measured speed against positions, and correct positions by it.

Position q + e_q and speed q̇ + e_v are measured with noise densities N_q and N_v. At
each frequency, the estimate of position with the least variance is

    Q̂ = Q + G · (V − jωQ) / jω,     G = ω² N_q / (ω² N_q + N_v).

N_q is white. It is the part of the position spectrum in the noise band that is not
coherent with the speed, because a speed that was computed from positions has the same
noise. N_v is the speed spectrum in the noise band or, if larger, the difference between
speed and position beyond N_q. A speed that is filtered or wrong therefore has no weight
at the frequencies where it differs from positions.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.recording.recording import Recording
from hybrid.signals.cutoff import NOISE_BAND
from hybrid.signals.filters import Spectrum, butterworth_gain

_SEGMENT = 4.0  # s, length of a spectrum
_FEWEST = 64  # samples of a spectrum
_LARGEST_LAG = 0.05  # s, longer than any driver's average
_BAND = 1.2  # ratio of the frequencies over which noise is averaged
# A speed is used only if it agrees with positions where the arm moves.
_COHERENCE = 0.9
_SCALE_ERROR = 0.05
_LAG_PASSES, _LAG_TOLERANCE = 3, 0.05  # passes; samples
# Largest correction in standard deviations of its expected noise. It is twice the
# largest value among a log's many samples, because noise may grow with speed.
_LARGEST_CORRECTION = 8.0
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class SpeedCheck:
    """Comparison of measured speed and position, v(t) ≈ scale · q̇(t − lag).

    Values are NaN if the log has no speed or the joint does not move.

    Attributes:
        scale: Factor of each joint, shape (n,); 1 for a speed in rad/s.
        lag: Delay of the speed, shape (n,), [s].
        coherence: Coherence of speed and position at the frequencies of the motion,
            shape (n,), 0 to 1.
        same_noise: Coherence in the noise band, shape (n,). It is near 1 if the speed
            was computed from these positions, and then adds no information.
        noise: Noise density of the positions, shape (n,), [rad²/Hz].
        frequency: Frequencies of the weight, shape (F,), [Hz].
        weight: Weight G of the speed, shape (F, n); 0 for a speed that is not used.
    """

    scale: Array
    lag: Array
    coherence: Array
    same_noise: Array
    noise: Array
    frequency: Array
    weight: Array


def speed_against_position(recording: Recording) -> SpeedCheck:
    """Compare each joint's measured speed with position, and weight it.

    The clock must be uniform. Scale and lag are found by least squares in the frequency
    domain. Each frequency is weighted by the inverse noise of both channels.
    """
    n, v = recording.size, recording.v
    if v is None or len(v) < _FEWEST:
        return SpeedCheck(*(np.full(n, np.nan),) * 5, np.zeros(1), np.zeros((1, n)))
    rate = (len(v) - 1) / recording.duration
    u, lag = _position_difference(recording), np.zeros(n)
    check = _compare(u, v, rate)
    for _ in range(_LAG_PASSES):
        if np.abs(check.lag).max() * rate < _LAG_TOLERANCE:
            break
        lag = np.clip(lag + check.lag, -_LARGEST_LAG, _LARGEST_LAG)
        check = _compare(u, _advanced(v, lag, rate), rate)
    return replace(check, lag=np.where(np.isnan(check.scale), np.nan, lag))


def _compare(u: Array, v: Array, rate: float) -> SpeedCheck:
    """Compare central differences u of position with speeds v, shapes (N, n)."""
    f, densities = _densities(u, v, rate)
    uu, vv, uv, aa, av, au = (x.real for x in densities)
    w, in_band = 2 * np.pi * f[:, None], f >= f[-1] * NOISE_BAND[0] / NOISE_BAND[1]
    coherence = np.abs(densities[2]) ** 2 / np.maximum(uu * vv, _TINY)
    same_noise = np.mean(coherence[in_band], axis=0)
    noise = (1 - same_noise) * np.median((uu / w**2)[in_band], axis=0)
    position_noise, speed_noise = w**2 * noise, np.median(vv[in_band], axis=0)
    weight = 1 / np.maximum(position_noise + speed_noise, _TINY)
    weight = np.where(uu > 2 * position_noise, weight, 0)
    terms = np.maximum(uu - position_noise, 0), uv, au, uu, av, aa, vv
    power, uv_, au_, uu_, av_, aa_, vv_ = ((weight * x).sum(axis=0) for x in terms)
    with np.errstate(divide="ignore", invalid="ignore"):
        # Least squares of v ≈ scale · (u − lag · a).
        lag = np.nan_to_num((au_ * uv_ - uu_ * av_) / (aa_ * uv_ - au_ * av_))
        scale = uv_ / power
        error = np.maximum(vv / scale**2 + uu - 2 * uv / scale, 0)
        coherence = uv_**2 / uu_ / np.maximum(vv_, _TINY)
        good = (coherence > _COHERENCE) & (np.abs(scale - 1) < _SCALE_ERROR)
        speed_noise = np.maximum(
            _smooth(f, error) - position_noise, speed_noise / scale**2
        )
        gain = np.where(good, 1 / (1 + speed_noise / position_noise), 0)
    gain = np.nan_to_num(gain)
    return SpeedCheck(scale, lag, coherence, same_noise, noise, f, gain)


def correction_by_speed(
    recording: Recording,
    *,
    cutoff: float,
    mask: Mask,
    check: SpeedCheck | None = None,
) -> Array:
    """Correction of low-passed positions by the measured speed, shape (N, n), [rad].

    If the correction of a joint is larger than the noise of positions can be, the speed
    contradicts them. It is then not used, and the correction is zero.

    Args:
        recording: Joint log on a uniform clock.
        cutoff: Cut-off of :func:`butterworth`, [Hz]; inf for none.
        mask: Samples whose correction is compared with the noise, shape (N,).
        check: Result of :func:`speed_against_position`, if it was made before.
    """
    check, v = check or speed_against_position(recording), recording.v
    correction = np.zeros_like(recording.q)
    use = np.flatnonzero(check.weight.any(axis=0))
    if v is None or not len(use):
        return correction
    from scipy.fft import irfft, next_fast_len, rfft

    samples, rate = len(v), (len(v) - 1) / recording.duration
    pad = min(int(_SEGMENT * rate), samples - 1)
    size = next_fast_len(samples + 2 * pad, real=True)
    f = _moving_band(size, rate)
    w, slope = 2 * np.pi * f, np.sinc(2 * f / rate)
    low = butterworth_gain(f, rate=rate, cutoff=cutoff)
    u = _position_difference(recording)
    v = _advanced(v, np.nan_to_num(check.lag), rate)
    for j in use:
        both = np.pad(np.stack([u[:, j], v[:, j]]), ((0, 0), (pad, pad)), "reflect")
        U, V = rfft(both, size)[:, 1 : len(f) + 1]
        error = V / check.scale[j] - U / slope
        gain = low * np.interp(f, check.frequency, check.weight[:, j])
        found = irfft(np.append(0, gain * error / (1j * w)), size)[pad : pad + samples]
        expected = np.sqrt(check.noise[j] * (low * gain).sum() * f[0])
        if np.abs(found[mask]).max(initial=0.0) < _LARGEST_CORRECTION * expected:
            correction[:, j] = found
    return correction


def _position_difference(recording: Recording) -> Array:
    """Central differences of position, (N, n): q̇ with a gain of sinc(2 f / rate)."""
    rate = (len(recording.t) - 1) / recording.duration
    return np.asarray(np.gradient(recording.q, axis=0) * rate)


def _densities(u: Array, v: Array, rate: float) -> tuple[Array, list[Spectrum]]:
    """Frequencies, and cross densities of u, a = du/dt and v."""
    from scipy.fft import rfft
    from scipy.signal import get_window

    size = min(len(u), int(_SEGMENT * rate))
    count = 2 * len(u) // size - 1
    f = _moving_band(size, rate)
    slope, window = np.sinc(2 * f / rate), get_window("blackmanharris", size)
    window /= np.sqrt((window**2).sum() * rate / 2)  # one-sided densities
    signals = np.stack([u.T, np.gradient(u.T, axis=1) * rate, v.T])
    sums: list[Any] = [0.0] * 6
    for first in np.linspace(0, len(u) - size, count).astype(int):
        part = signals[..., first : first + size]
        part = window * (part - part.mean(axis=-1, keepdims=True))
        U, A, V = rfft(part)[..., 1 : len(f) + 1]
        U, A = U / slope, A / slope**2
        terms = (U, U), (V, V), (U, V), (A, A), (A, V), (A, U)
        sums = [s + x.conj() * y for s, (x, y) in zip(sums, terms, strict=True)]
    return f, [s.T / count for s in sums]


def _moving_band(size: int, rate: float) -> Array:
    """Frequencies of ``rfft`` between zero and the end of the noise band, [Hz]."""
    f = np.asarray(np.fft.rfftfreq(size, 1 / rate), dtype=np.float64)
    return f[1 : np.searchsorted(f, NOISE_BAND[1] * rate)]


def _advanced(x: Array, lag: Array, rate: float) -> Array:
    """Shift signals (N, n) to earlier times, each by its lag, shape (n,), [s]."""
    from scipy.fft import irfft, next_fast_len, rfft

    pad = min(int(2 * _LARGEST_LAG * rate) + 1, len(x) - 1)
    size = next_fast_len(len(x) + 2 * pad, real=True)
    w = 2 * np.pi * np.fft.rfftfreq(size, 1 / rate)
    # Point reflection keeps value and slope at the ends.
    padded = np.pad(x.T, ((0, 0), (pad, pad)), "reflect", reflect_type="odd")
    spectrum = rfft(padded, size)
    shifted = irfft(spectrum * np.exp(1j * w * lag[:, None]), size)
    return np.asarray(shifted[:, pad : pad + len(x)].T)


def _smooth(f: Array, x: Array) -> Array:
    """Mean over the band of frequencies around each one, shape (F, n)."""
    first = np.searchsorted(f, f / _BAND)
    last = np.searchsorted(f, f * _BAND, side="right")
    sums = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])
