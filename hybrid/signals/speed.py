"""Measured speed: what it is worth beside differentiated position, and both as one.

Position q + e_q and speed q̇ + e_v with noise densities N_q, N_v tell of one motion. At
each frequency, the estimate of least variance from both is

    Q̂ = Q + G · (V − jωQ) / jω,     G = ω² N_q / (ω² N_q + N_v):

position below the crossover of the two noises, integrated speed above. The noise of
positions is white: their spectrum where nothing moves. That of a speed is its own there
and, elsewhere, by how much more than the noise of positions it contradicts them: a speed
that is filtered or wrong loses its weight at the frequencies at which that shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hybrid.recording.recording import Recording
from hybrid.signals.filters import low_pass_gain

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

QUIET = (0.3, 0.45)  # of the rate: frequencies at which an arm does not move
_SEGMENT = 4.0  # s: of a spectrum
_FEWEST = 64  # samples of which a spectrum is made
_LATEST = 0.05  # s: drivers average over less
_BAND = 1.2  # ratio of frequencies that are alike
# A speed is used if it agrees with positions where the arm moves, is a speed in rad/s,
# and has noise of its own where nothing moves: else it was computed from these positions.
_COHERENT = 0.9
_WORST_SCALE = 0.05
_FARTHEST = 6.0  # times their noise: more than that, positions are not corrected


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

    Scale and lag are those of least squares in the frequency domain. Each frequency
    counts by the noise of both channels there, so only those at which the arm moves do.

    Args:
        recording: Joint log on a uniform clock.
    """
    n, v = recording.size, recording.v
    if v is None or len(v) < _FEWEST:
        return SpeedCheck(*(np.full(n, np.nan),) * 6, np.zeros(1), np.zeros((1, n)))
    rate = (len(v) - 1) / recording.duration
    f, uu, vv, uv, count = _spectra(_difference(recording), v, rate)
    quiet, w = f > QUIET[0] * rate, 2 * np.pi * f[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        same = np.mean(np.abs(uv[quiet]) ** 2 / (uu * vv)[quiet], axis=0)
        noise = (1 - same) * np.median(uu[quiet] / w[quiet] ** 2, axis=0)
        of_position, of_speed = w**2 * noise, np.median(vv[quiet], axis=0)
        worth = 1 / (of_position + of_speed)
        moving = worth * np.maximum(uu - of_position, 0)
        lag = _lag(w, worth * uv, rate)
        turned = (uv * np.exp(1j * w * lag)).real
        power, both = moving.sum(axis=0), (worth * turned).sum(axis=0)
        scale = both / power
        apart = np.maximum(vv / scale**2 + uu - 2 * turned / scale, 0)
        std = np.sqrt((moving * worth * apart).sum(axis=0) / count) / power
        present = np.maximum((worth * vv).sum(axis=0), np.finfo(float).tiny)
        coherence = both**2 / (worth * uu).sum(axis=0) / present
        good = (coherence > _COHERENT) & (np.abs(scale - 1) < _WORST_SCALE)
        more = np.maximum(_smooth(f, apart) - of_position, of_speed / scale**2)
        weight = np.where(good, 1 / (1 + more / of_position), 0)
    weight = np.nan_to_num(weight)
    return SpeedCheck(scale, std, lag, coherence, same, noise, f, weight)


def correction_by_speed(recording: Recording, *, cutoff: float) -> Array:
    """What measured speeds add to low-passed positions to give those of least noise.

    Where that is more than the noise of positions can be, a speed contradicts them: it
    is then not used at all.

    Args:
        recording: Joint log on a uniform clock.
        cutoff: Cut-off of the same filter as :func:`butterworth`, [Hz]; inf for none.

    Returns:
        Shape (N, n), [rad]; exactly zero for a joint whose speed is not worth anything.
    """
    check = speed_against_position(recording)
    added = np.zeros_like(recording.q)
    use = np.flatnonzero(check.weight.any(axis=0))
    if recording.v is None or not len(use):
        return added
    from scipy.fft import irfft, next_fast_len, rfft

    samples = len(recording.t)
    rate = (samples - 1) / recording.duration
    pad = min(int(_SEGMENT * rate), samples - 1)
    size = next_fast_len(samples + 2 * pad, real=True)
    f = np.fft.rfftfreq(size, 1 / rate)[1:]
    f = f[f < QUIET[1] * rate]
    w = 2 * np.pi * f
    low = low_pass_gain(f, rate=rate, cutoff=cutoff)
    u = _difference(recording)
    for j in use:
        both = np.stack([u[:, j], recording.v[:, j]])
        both = rfft(np.pad(both, ((0, 0), (pad, pad)), mode="reflect"), size)
        U, V = both[:, 1 : len(f) + 1]
        U /= np.sinc(2 * f / rate)
        V *= np.exp(1j * w * check.lag[j]) / check.scale[j]
        gain = np.interp(f, check.frequency, check.weight[:, j])
        found = np.concatenate([[0], low * gain * (V - U) / (1j * w)])
        found = irfft(found, size)[pad : pad + samples]
        usual = check.noise[j] * (low**2 * gain).sum() * f[0]
        if np.abs(found).max() < _FARTHEST * np.sqrt(usual):
            added[:, j] = found
    return added


def _difference(recording: Recording) -> Array:
    """Central differences of position, (N, n): q̇ less a gain of sinc(2 f / rate)."""
    rate = (len(recording.t) - 1) / recording.duration
    return np.asarray(np.gradient(recording.q, axis=0) * rate)


def _spectra(
    u: Array, v: Array, rate: float
) -> tuple[Array, Array, Array, Spectrum, int]:
    """Frequencies (F,), spectra (F, n) of both signals and of them, and their count.

    Args:
        u: Central differences of position, shape (N, n), [rad/s].
        v: Measured speed, shape (N, n), [rad/s].
        rate: Samples per second, [Hz].
    """
    from scipy.fft import rfft
    from scipy.signal.windows import blackmanharris

    size = min(len(u), int(_SEGMENT * rate))
    count = 2 * len(u) // size - 1
    f = np.fft.rfftfreq(size, 1 / rate)[1:]
    f = f[f < QUIET[1] * rate]
    slope = np.sinc(2 * f / rate)
    window = blackmanharris(size)
    window /= np.sqrt((window**2).sum() * rate / 2)  # one-sided densities
    uu = vv = np.zeros(())
    uv = np.zeros((), dtype=complex)
    for first in np.linspace(0, len(u) - size, count).astype(int):
        parts = np.stack([x[first : first + size].T for x in (u, v)])
        parts = window * (parts - parts.mean(axis=-1, keepdims=True))
        U, V = rfft(parts)[..., 1 : len(f) + 1]
        U /= slope
        uu, vv, uv = uu + np.abs(U) ** 2, vv + np.abs(V) ** 2, uv + U.conj() * V
    return f, uu.T / count, vv.T / count, uv.T / count, count


def _lag(w: Array, uv: Spectrum, rate: float) -> Array:
    """Lag of greatest cross-correlation in size, shape (n,), [s].

    Args:
        w: Frequencies, shape (F, 1), [rad/s].
        uv: Cross-spectrum, shape (F, n).
        rate: Samples per second, [Hz].
    """
    uv = np.nan_to_num(uv)
    most = int(np.ceil(_LATEST * rate))
    lags = np.arange(-most, most + 1) / rate
    lag = lags[np.argmax(np.abs((np.exp(1j * lags[:, None] * w.T) @ uv).real), axis=0)]
    for _ in range(3):  # Newton's method: between samples
        turned = uv * np.exp(1j * w * lag)
        bend = (w**2 * turned.real).sum(axis=0)
        step = -(w * turned.imag).sum(axis=0) / np.where(bend == 0, 1, bend)
        lag = lag + np.clip(step, -1 / rate, 1 / rate)
    return lag


def _smooth(f: Array, x: Array) -> Array:
    """Mean over a band of frequencies around each, shape (F, n)."""
    first = np.searchsorted(f, f / _BAND)
    last = np.searchsorted(f, f * _BAND, side="right")
    sums = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    return np.asarray((sums[last] - sums[first]) / (last - first)[:, None])
