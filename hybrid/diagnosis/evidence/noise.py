"""Noise of a joint: an autoregressive process, and estimates from a residual.

Sensor noise is as strong at all frequencies, and that of derivatives is stronger at
high ones. So the upper half of a residual's band shows its noise; what exceeds that in
the lower half is not noise.

A residual with holes is given by its values ``x`` and their positions in time ``row``,
shape (R,) each, its ``rate``, and the ``cutoff`` of its band, both in [Hz].
"""

import numpy as np
from scipy import sparse
from scipy.linalg import toeplitz

from hybrid.arrays import Array, Index, Mask
from hybrid.signals.filters import LOWER_BAND

LAGS = 16  # largest lag of a noise covariance
_UPPER_BAND = LOWER_BAND, 0.85  # of the cut-off
_LEAST = 1e-6  # of the variance
_STRETCH = 0.5  # s, over which the power of noise is averaged
_EVENT = 8.0  # times the median power


class Noise:
    """A Gaussian autoregressive process, with holes, of a joint's samples.

    Whitened samples are independent, of variance one. The first samples after a hole
    are whitened with the few samples before them.

    Args:
        covariance: Covariance at lags 0 to p, shape (p + 1,), [N²·m²].
        follows: Whether a sample directly follows the one before it, shape (R,).
        size: RMS noise of each sample over that of the process, shape (R,).

    Source: Durbin 1960, doi 10.2307/1401322 (predictors of rising order).
    """

    def __init__(
        self, covariance: Array, follows: Mask, size: Array | float = 1.0
    ) -> None:
        predictors = _predictors(covariance)  # (p + 1, p + 1)
        count, p = len(follows), len(covariance) - 1
        start = np.where(follows, 0, np.arange(count))
        since = np.arange(count) - np.maximum.accumulate(start)
        by_row = predictors[np.minimum(since, p)]  # (R, p + 1)
        bands = np.zeros((p + 1, count))  # as SciPy stores lower bands
        for k in range(min(p + 1, count)):
            bands[k, : count - k] = by_row[k:, k]
        lower = sparse.dia_array((bands, -np.arange(p + 1)), shape=(count, count))
        usual = sparse.diags_array(1.0 / np.broadcast_to(size, count))
        self._matrix = (lower.tocsr() @ usual).tocsr()
        self._transposed = self._matrix.T.tocsr()

    def whiten(self, x: Array) -> Array:
        """Whitened samples, shape (R, ...)."""
        return np.asarray(self._matrix @ x)

    def weight(self, x: Array) -> Array:
        """Samples times the inverse covariance of the process, shape (R, ...)."""
        return self.weight_white(self.whiten(x))

    def weight_white(self, white: Array) -> Array:
        """What :meth:`weight` gives of samples, from the whitened ones."""
        return np.asarray(self._transposed @ white)


def whitened_power(by: Array, covariance: Array) -> float:
    """Mean square of a process whitened as another one, by their covariances."""
    last = _predictors(by)[-1]
    return float(last @ toeplitz(covariance) @ last)


def _predictors(covariance: Array) -> Array:
    """Whitening filters of rising order, one a row, shape (p + 1, p + 1)."""
    p = len(covariance) - 1
    filters, a, error = np.zeros((p + 1, p + 1)), np.zeros(p + 1), covariance[0]
    a[0] = 1.0
    filters[0] = a / np.sqrt(error)
    for m in range(1, p + 1):
        reflection = -(a[:m] @ covariance[m:0:-1]) / error
        a[: m + 1] = a[: m + 1] + reflection * a[m::-1]
        error *= 1.0 - reflection**2
        filters[m] = a / np.sqrt(error)
    return filters


def autocovariance(x: Array, row: Index, lags: int) -> Array:
    """Autocovariance of a residual at lags from 0 to the largest, (lags + 1,)."""
    full = np.zeros(np.ptp(row) + 1 + lags)
    full[row - row.min()] = x
    end = len(full) - lags
    return np.array([full[:end] @ full[k : end + k] for k in range(lags + 1)]) / len(x)


def floored(covariance: Array, cutoff: float) -> Array:
    """Covariance of a filtered process, with the noise of its upper band in all bands.

    Without it the stop band of a low-pass filter would count as free of noise.

    Args:
        covariance: Covariance at lags from zero on, shape (p + 1,).
        cutoff: Cut-off of the filter, in cycles per sample.
    """
    p = len(covariance) - 1
    lag = np.arange(1, p + 1)
    f = cutoff * np.linspace(*_UPPER_BAND, 20)
    taper = 1.0 - lag / (p + 1)  # keeps the density positive
    density = covariance[0] + 2 * np.cos(2 * np.pi * np.outer(f, lag)) @ (
        taper * covariance[1:]
    )
    out = covariance.copy()
    out[0] += max(float(density.mean()), _LEAST * covariance[0], 1e-300)
    return out


def without_events(x: Array, row: Index, rate: float) -> Mask:
    """Samples of a residual in stretches of usual power, shape (R,).

    The power of noise is the same at all times. A stretch with many times the median
    power holds an event.
    """
    stretch = row // round(_STRETCH * rate)
    count = np.bincount(stretch)
    mean = np.bincount(stretch, x**2) / np.maximum(count, 1)
    usual = np.median(mean[count > 0]) if len(x) else 0.0
    return np.asarray(mean[stretch] <= _EVENT * usual)


def low_frequency_excess(x: Array, row: Index, rate: float, cutoff: float) -> float:
    """Squares in the lower half of a residual's band beyond those of its noise."""
    power, f = _spectrum(x, row, rate)
    lower, upper = power[f < LOWER_BAND * cutoff], _upper(power, f / cutoff)
    return float(lower.sum() - len(lower) * upper.mean()) if len(upper) else 0.0


def noise_bound(x: Array, row: Index, rate: float, cutoff: float) -> float:
    """Upper bound of the mean square of a signal's noise, from its upper half band."""
    power, f = _spectrum(x, row, rate)
    upper = _upper(power, f / cutoff)
    return float(np.sum(f < cutoff) * upper.mean() / len(x)) if len(upper) else 0.0


def _spectrum(x: Array, row: Index, rate: float) -> tuple[Array, Array]:
    """Squares of a residual at each frequency of both signs, and the frequencies."""
    full = np.zeros(np.ptp(row) + 1)
    full[row - row.min()] = x
    power = 2 * np.abs(np.fft.rfft(full)) ** 2 / len(full)
    power[0] /= 2  # a constant has one sign only
    return power, np.asarray(np.fft.rfftfreq(len(full), 1.0 / rate))


def _upper(power: Array, f: Array) -> Array:
    low, high = _UPPER_BAND
    return power[(f >= low) & (f < high)]
