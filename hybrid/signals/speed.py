"""Measured speed: what it is worth beside differentiated position, and both as one.

Position q + e_q and speed q̇ + e_v with noise densities N_q, N_v tell of one motion. At
each frequency, the estimate of least variance from both is

    Q̂ = Q + G · (V − jωQ) / jω,     G = ω² N_q / (ω² N_q + N_v):

position below the crossover of the two noises, integrated speed above. The noise of
positions is white: what of their spectrum, where nothing moves, is not in the speed too
(one that was computed from them shares all). That of a speed is its spectrum there and,
elsewhere, by how much more than their noise it contradicts positions: a speed that is
filtered or wrong loses its weight at the frequencies at which that shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.recording.recording import Recording
from hybrid.signals.cutoff import QUIET, blackman_harris
from hybrid.signals.filters import Spectrum, butterworth_gain

_SEGMENT = 4.0  # s: of a spectrum
_FEWEST = 64  # samples of which a spectrum is made
_LATEST = 0.05  # s: drivers average over less
_BAND = 1.2  # ratio of frequencies that are alike
# A speed is used if it is one: it agrees with positions where the arm moves, in rad/s.
_COHERENT = 0.9
_WORST_SCALE = 0.05  # off one
_MOST_SHIFTS, _SHIFTED = 3, 0.05  # passes; samples
# Times their usual noise that positions are corrected, at most: twice the largest of a
# log's many samples, as some noise is greater where the arm is fast.
_FARTHEST = 8.0
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False)
class SpeedCheck:
    """Measured speed held against position, v(t) ≈ scale · q̇(t − lag).

    What cannot be told (no speed in the log, a joint that stands) is NaN.

    Attributes:
        scale: Factor of each joint, shape (n,); 1 for a speed in rad/s.
        scale_std: Its standard deviation, shape (n,).
        lag: Time by which the speed comes late, shape (n,), [s].
        coherence: Share of the speed's power that position explains where the joint
            moves, shape (n,), 0 to 1.
        same_noise: The same where nothing moves, shape (n,): near 1 for a speed that
            was computed from these positions, and adds nothing to them.
        noise: Density of the positions' own noise, shape (n,), [rad²/Hz].
        frequency: Frequencies of the weight, shape (F,), [Hz].
        weight: Weight G of the speed, shape (F, n); 0 for a speed not to be used.
    """

    scale: Array
    scale_std: Array
    lag: Array
    coherence: Array
    same_noise: Array
    noise: Array
    frequency: Array
    weight: Array


def speed_against_position(recording: Recording) -> SpeedCheck:
    """Scale, lag and coherence of each joint's measured speed, and its best weight.

    The clock is uniform. Scale and lag are those of least squares in the frequency
    domain. Each frequency counts by the noise of both channels there, so only those at
    which the arm moves do.
    """
    n, v = recording.size, recording.v
    if v is None or len(v) < _FEWEST:
        return SpeedCheck(*(np.full(n, np.nan),) * 6, np.zeros(1), np.zeros((1, n)))
    rate = (len(v) - 1) / recording.duration
    u, prompt, lag = _difference(recording), v, np.zeros(n)
    both = _spectra(u, prompt, rate)
    for _ in range(_MOST_SHIFTS):
        late = both.lag
        if np.abs(late).max() * rate < _SHIFTED:
            break
        lag = np.clip(lag + late, -_LATEST, _LATEST)
        prompt = _earlier(v, lag, rate)
        both = _spectra(u, prompt, rate)
    return _judged(both, lag)


def _judged(both: _Spectra, lag: Array) -> SpeedCheck:
    """Judge spectra of two signals that are in step, after one came late."""
    uu, vv, uv = both.uu, both.vv, both.uv
    worth, of_position = both.worth, both.of_position
    with np.errstate(divide="ignore", invalid="ignore"):
        moving = worth * np.maximum(uu - of_position, 0)
        power, shared = moving.sum(axis=0), (worth * uv).sum(axis=0)
        scale = shared / power
        apart = np.maximum(vv / scale**2 + uu - 2 * uv / scale, 0)
        std = np.sqrt((moving * worth * apart).sum(axis=0) / both.count) / power
        present = np.maximum((worth * vv).sum(axis=0), _TINY)
        coherence = shared**2 / (worth * uu).sum(axis=0) / present
        good = (coherence > _COHERENT) & (np.abs(scale - 1) < _WORST_SCALE)
        more = np.maximum(
            _smooth(both.f, apart) - of_position, both.of_speed / scale**2
        )
        weight = np.nan_to_num(np.where(good, 1 / (1 + more / of_position), 0))
    lag = np.where(np.isnan(scale), np.nan, lag)
    return SpeedCheck(
        scale, std, lag, coherence, both.same_noise, both.noise, both.f, weight
    )


def correction_by_speed(
    recording: Recording,
    *,
    cutoff: float,
    mask: NDArray[np.bool_],
    check: SpeedCheck | None = None,
) -> Array:
    """Correction (N, n) of low-passed positions by measured speed, for the least noise.

    Where that is more than the noise of positions can be, a speed contradicts them: it
    is then not used at all, and the correction exactly zero.

    Args:
        recording: Joint log on a uniform clock.
        cutoff: Cut-off of the same filter as :func:`butterworth`, [Hz]; inf for none.
        mask: Samples by which a speed is judged, shape (N,).
        check: What :func:`speed_against_position` says of it, if that is known.
    """
    check, v = check or speed_against_position(recording), recording.v
    added = np.zeros_like(recording.q)
    use = np.flatnonzero(check.weight.any(axis=0))
    if v is None or not len(use):
        return added
    from scipy.fft import irfft, next_fast_len, rfft

    samples, rate = len(v), (len(v) - 1) / recording.duration
    pad = min(int(_SEGMENT * rate), samples - 1)
    size = next_fast_len(samples + 2 * pad, real=True)
    f = _moving_band(size, rate)
    w, slope = 2 * np.pi * f, np.sinc(2 * f / rate)
    low = butterworth_gain(f, rate=rate, cutoff=cutoff)
    u, v = _difference(recording), _earlier(v, np.nan_to_num(check.lag), rate)
    for j in use:
        both = np.pad(np.stack([u[:, j], v[:, j]]), ((0, 0), (pad, pad)), "reflect")
        U, V = rfft(both, size)[:, 1 : len(f) + 1]
        apart = V / check.scale[j] - U / slope
        gain = low * np.interp(f, check.frequency, check.weight[:, j])
        found = irfft(np.append(0, gain * apart / (1j * w)), size)[pad : pad + samples]
        usual = np.sqrt(check.noise[j] * (low * gain).sum() * f[0])
        if np.abs(found[mask]).max(initial=0.0) < _FARTHEST * usual:
            added[:, j] = found
    return added


def _difference(recording: Recording) -> Array:
    """Central differences of position, (N, n): q̇ less a gain of sinc(2 f / rate)."""
    rate = (len(recording.t) - 1) / recording.duration
    return np.asarray(np.gradient(recording.q, axis=0) * rate)


@dataclass(frozen=True)
class _Spectra:
    """What spectra tell of differentiated positions u and speeds v.

    Attributes:
        f: Frequencies, shape (F,), [Hz].
        uu: Density of u, shape (F, n), [rad²/s²/Hz].
        vv: Of v.
        uv: Of both, real part.
        count: Number of segments they are means of.
        same_noise: Coherence where nothing moves, shape (n,).
        noise: Density of the positions' noise that is not in v, shape (n,), [rad²/Hz].
        of_position: The same in u, shape (F, n).
        of_speed: Noise of v where nothing moves, shape (n,).
        worth: Weight of each frequency in least squares, shape (F, n); 0 for noise.
        lag: By least squares of v ≈ scale · (u − lag · du/dt), shape (n,), [s].
    """

    f: Array
    uu: Array
    vv: Array
    uv: Array
    count: int
    same_noise: Array
    noise: Array
    of_position: Array
    of_speed: Array
    worth: Array
    lag: Array


def _spectra(u: Array, v: Array, rate: float) -> _Spectra:
    """Spectra of central differences of position and of speed, shapes (N, n)."""
    f, count, densities = _densities(u, v, rate)
    uu, vv, uv, aa, av, au = (x.real for x in densities)
    w, still = 2 * np.pi * f[:, None], f >= f[-1] * QUIET[0] / QUIET[1]
    alike = np.abs(densities[2]) ** 2 / np.maximum(uu * vv, _TINY)
    same = np.mean(alike[still], axis=0)
    noise = (1 - same) * np.median((uu / w**2)[still], axis=0)
    of_position, of_speed = w**2 * noise, np.median(vv[still], axis=0)
    worth = 1 / np.maximum(of_position + of_speed, _TINY)
    worth = np.where(uu > 2 * of_position, worth, 0)
    terms = (uv, au, uu, av, aa)
    uv_, au_, uu_, av_, aa_ = ((worth * x).sum(axis=0) for x in terms)
    with np.errstate(divide="ignore", invalid="ignore"):
        lag = np.nan_to_num((au_ * uv_ - uu_ * av_) / (aa_ * uv_ - au_ * av_))
    return _Spectra(
        f, uu, vv, uv, count, same, noise, of_position, of_speed, worth, lag
    )


def _densities(u: Array, v: Array, rate: float) -> tuple[Array, int, list[Spectrum]]:
    """Frequencies, segments, and densities of pairs of u, its slope a, and v."""
    from scipy.fft import rfft

    size = min(len(u), int(_SEGMENT * rate))
    count = 2 * len(u) // size - 1
    f = _moving_band(size, rate)
    slope, window = np.sinc(2 * f / rate), blackman_harris(size)
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
    return f, count, [s.T / count for s in sums]


def _moving_band(size: int, rate: float) -> Array:
    """Frequencies of ``rfft`` above zero at which differences tell a slope, [Hz]."""
    f = np.asarray(np.fft.rfftfreq(size, 1 / rate), dtype=np.float64)
    return f[1 : np.searchsorted(f, QUIET[1] * rate)]


def _earlier(x: Array, lag: Array, rate: float) -> Array:
    """Signals (N, n), each earlier by its lag, shape (n,), [s]."""
    from scipy.fft import irfft, next_fast_len, rfft

    pad = min(int(2 * _LATEST * rate) + 1, len(x) - 1)
    size = next_fast_len(len(x) + 2 * pad, real=True)
    w = 2 * np.pi * np.fft.rfftfreq(size, 1 / rate)
    # Point reflection keeps value and slope at the ends, which shifts bring in.
    longer = np.pad(x.T, ((0, 0), (pad, pad)), "reflect", reflect_type="odd")
    spectrum = rfft(longer, size)
    shifted = irfft(spectrum * np.exp(1j * w * lag[:, None]), size)
    return np.asarray(shifted[:, pad : pad + len(x)].T)


def _smooth(f: Array, x: Array) -> Array:
    """Mean over a band of frequencies around each, shape (F, n)."""
    first = np.searchsorted(f, f / _BAND)
    last = np.searchsorted(f, f * _BAND, side="right")
    sums = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])
