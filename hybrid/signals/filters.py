"""Filter arrays without phase shift, decimate and differentiate them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array

Label = TypeVar("Label", bound=np.generic)
Spectrum = NDArray[np.complex128]

LOWER_BAND = 0.5  # of the cut-off: above it, derivatives of positions are mostly noise
_ORDER = 5  # of the Butterworth filter in one pass
_SAMPLES_PER_PERIOD = 3.5  # of the cut-off, that decimation keeps
_BLOCK = 12  # signals filtered at a time: they fit into the processor's cache
_SHORT = 0.7  # of a signal: a shorter non-zero part is filtered alone


@dataclass(frozen=True)
class Sampler:
    """Zero-phase low-pass filter and decimation, the same for columns and torque.

    A long recording may be filtered in chunks. Each chunk starts at a multiple of
    ``factor`` and overlaps its neighbours by ``margin`` samples. The samples inside
    then differ from those of the whole recording by less than 1e-6.

    Attributes:
        rate: Rate of the input, [Hz].
        cutoff: Cut-off of :func:`butterworth`, [Hz]; inf for none.
        factor: Every ``factor``-th sample is kept.
    """

    rate: float
    cutoff: float
    factor: int

    def __post_init__(self) -> None:
        if not (self.rate > 0 and self.cutoff > 0 and self.factor >= 1):
            raise ValueError(
                f"rate {self.rate}, cutoff {self.cutoff}, factor {self.factor}: valid "
                "are positive rate and cutoff and a factor from 1"
            )

    @classmethod
    def for_rate(cls, rate: float, cutoff: float) -> Sampler:
        """Choose the largest factor that keeps 3.5 samples per cut-off period.

        Only frequencies above 2.5 times the cut-off are then aliased below it. The
        filter passes 1e-4 of their amplitude, so that aliasing is negligible.
        """
        factor = max(1, int(rate / (_SAMPLES_PER_PERIOD * cutoff) + 1e-9))
        return cls(rate=rate, cutoff=cutoff, factor=factor)

    @property
    def margin(self) -> int:
        """Number of input samples after which the influence of one is below 1e-6."""
        if passes_all(self.rate, self.cutoff):
            return 0
        return filter_reach(self.cutoff / self.rate)

    def __call__(self, x: Array, axis: int = 0) -> Array:
        """Filter along ``axis`` (edges padded), then keep every ``factor``-th sample.

        Args:
            x: Signals in any unit, N samples along ``axis``.
            axis: Axis of time; the last one is fastest.

        Returns:
            Signals with ceil(N / factor) samples along ``axis``, contiguous.
        """
        return _filtered(x, self.rate, self.cutoff, axis, self.factor)

    def keep(self, x: NDArray[Label]) -> NDArray[Label]:
        """Select the rows of masks or labels, shape (N, ...), that decimation keeps."""
        return x[:: self.factor]


def butterworth(x: Array, *, rate: float, cutoff: float) -> Array:
    """Low-pass filter without delay: a Butterworth filter run forward and backward.

    The gain of both passes together is that of the bilinear filter of order 5, squared:
    1 / (1 + (tan(π f / rate) / tan(π cutoff / rate))^10). It is applied in the
    frequency domain, in a third of the time of second-order sections. Beyond its ends
    a signal is continued by point reflection, which keeps value and slope.

    Args:
        x: Signals in any unit, uniform samples along the first axis.
        rate: Samples per second, [Hz].
        cutoff: Frequency at which the gain is one half, [Hz]. From 0.98 of the Nyquist
            frequency on, ``x`` is returned unchanged.

    Returns:
        Filtered signals, the shape of ``x``.
    """
    return _filtered(x, rate, cutoff, 0, 1)


def butterworth_gain(frequency: Array, *, rate: float, cutoff: float) -> Array:
    """Gain of :func:`butterworth` at frequencies in [Hz]; 0 above half the rate."""
    if passes_all(rate, cutoff):
        return np.asarray(frequency < rate / 2, dtype=np.float64)
    below = np.clip(np.abs(frequency) / rate, 0.0, 0.4999)
    with np.errstate(over="ignore"):
        warped = np.tan(np.pi * below) / np.tan(np.pi * cutoff / rate)
        return np.asarray(1.0 / (1.0 + warped ** (2 * _ORDER)))


@lru_cache(maxsize=64)
def filter_reach(relative_cutoff: float, *, tolerance: float = 1e-6) -> int:
    """Number of samples after which the impulse response of the filter is negligible.

    Args:
        relative_cutoff: Cut-off divided by rate.
        tolerance: Largest sum of the absolute weights beyond. A quarter of it is used,
            because point reflection may err by four times the signal.
    """
    size = 1 << int(np.ceil(np.log2(64 * _ORDER / relative_cutoff)))
    weights = np.abs(np.fft.irfft(_gain(relative_cutoff, size)))[: size // 2]
    outside = 2 * np.cumsum(weights[::-1])[::-1]  # from lag k on, on both sides
    return int(np.argmax(outside < tolerance / 4))


def central_difference(x: Array, *, rate: float) -> Array:
    """Time derivative by central differences of order 4, of order 2 at the edges.

    Args:
        x: Signals in any unit, at least three uniform samples along the first axis.
        rate: Samples per second, [Hz].

    Returns:
        Derivative in that unit per second, the shape of ``x``.
    """
    x = np.asarray(x, dtype=np.float64)
    slope = np.gradient(x, axis=0, edge_order=2) * rate
    if len(x) >= 5:
        slope[2:-2] = (8 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) * (rate / 12)
    return np.asarray(slope)


def lagged(x: Array, *, step: float, time: float) -> Array:
    """A signal after a lag of first order that begins in steady state, (N, ...).

    The step between samples and the lag's time constant are in [s]; trapezoidal rule.
    """
    from scipy.signal import lfilter

    share = step / (2.0 * time + step)
    pole = (2.0 * time - step) / (2.0 * time + step)
    begin = (1.0 - share) * x[:1]
    return np.asarray(lfilter([share, share], [1.0, -pole], x, axis=0, zi=begin)[0])


def passes_all(rate: float, cutoff: float) -> bool:
    """Tell whether a cut-off in [Hz] is so near Nyquist that all passes."""
    if not cutoff > 0:
        raise ValueError(f"cutoff {cutoff} Hz; valid is a positive frequency or inf")
    return cutoff >= 0.98 * rate / 2


@lru_cache(maxsize=64)
def _gain(relative_cutoff: float, size: int) -> Array:
    """Gain of both passes at the frequencies of ``rfft``, shape (size//2 + 1,)."""
    f = np.asarray(np.fft.rfftfreq(size), dtype=np.float64)
    return butterworth_gain(f, rate=1.0, cutoff=relative_cutoff)


def _aliased(spectrum: Spectrum, size: int, factor: int) -> Spectrum:
    """Spectra of decimated signals from those of ``rfft``, shape (k, size//2 + 1).

    The size is a multiple of the factor. As many frequencies as the factor says fall
    onto each one.
    """
    decimated = size // factor
    half = decimated // 2 + 1
    out = spectrum[:, :half].copy()
    for first in range(decimated, size, decimated):
        direct = spectrum[:, first : first + half]
        count = direct.shape[1]
        out[:, :count] += direct
        mirrored = spectrum[:, size - first - count : size - first - half : -1]
        out[:, count:] += mirrored.conj()
    return out


def _filtered(x: Array, rate: float, cutoff: float, axis: int, factor: int) -> Array:
    x = np.asarray(x, dtype=np.float64)
    # Transposed by hand: it is called thousands of times, and np.moveaxis is slow.
    axis %= x.ndim
    others = [k for k in range(x.ndim) if k != axis]
    x = x.transpose(*others, axis)
    back = [*range(axis), x.ndim - 1, *range(axis, x.ndim - 1)]
    if passes_all(rate, cutoff) or x.size == 0:
        return np.ascontiguousarray(x[..., ::factor].transpose(back))
    from scipy.fft import irfft, next_fast_len, rfft

    samples = x.shape[-1]
    pad = filter_reach(cutoff / rate, tolerance=1e-9)
    pad = -(-pad // factor) * factor
    kept = -(-samples // factor)
    first, last = _nonzero_range(x, pad, factor)
    if last - first < samples:
        out = np.zeros((*x.shape[:-1], kept))
        if last > first:
            part = _filtered(x[..., first:last], rate, cutoff, -1, factor)
            out[..., first // factor :][..., : part.shape[-1]] = part
        return np.ascontiguousarray(out.transpose(back))
    decimated = next_fast_len(-(-(samples + 2 * pad) // factor), real=True)
    size = factor * decimated
    gain = _gain(cutoff / rate, size) / factor
    signals = np.ascontiguousarray(x).reshape(-1, samples)
    out = np.empty((len(signals), kept))
    for i in range(0, len(signals), _BLOCK):
        spectrum = rfft(_continued(signals[i : i + _BLOCK], pad), size)
        spectrum *= gain
        spectrum = _aliased(spectrum, size, factor)
        out[i : i + _BLOCK] = irfft(spectrum, decimated)[:, pad // factor :][:, :kept]
    out = out.reshape(*x.shape[:-1], kept)
    return np.ascontiguousarray(out.transpose(back))


def _continued(x: Array, pad: int) -> Array:
    """Signals, one a row, continued by point reflection at both ends."""
    if pad >= x.shape[1]:
        return np.pad(x, ((0, 0), (pad, pad)), "reflect", reflect_type="odd")
    before = 2 * x[:, :1] - x[:, pad:0:-1]
    after = 2 * x[:, -1:] - x[:, -2 : -pad - 2 : -1]
    return np.concatenate([before, x, after], axis=1)


def _nonzero_range(x: Array, pad: int, factor: int) -> tuple[int, int]:
    """First sample and end of the part where filtered signals are not zero.

    It starts at a multiple of ``factor``. It is the whole range if the part is long, or
    if a signal is not zero at either end.
    """
    samples = x.shape[-1]
    if x[..., 0].any() or x[..., -1].any():
        return 0, samples
    nonzero = np.flatnonzero(x.any(axis=tuple(range(x.ndim - 1))))
    if not len(nonzero):
        return 0, 0
    first = max(nonzero[0] - 2 * pad, 0) // factor * factor
    last = min(nonzero[-1] + 1 + 2 * pad, samples)
    return (int(first), int(last)) if last - first < _SHORT * samples else (0, samples)
