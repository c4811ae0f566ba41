"""What a residual and a few columns say: evidence for them, and what noise there is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from hybrid.arrays import Array
from hybrid.signals import butterworth

_OWN = 0.3  # of the gain that columns are of, or it of that; noise lessens it
WIDER = 1.0, 10.0, 100.0  # each decade is ten times less probable
_STRETCH = 0.5  # s, in which noise is as large as ever
_EVENT = 8.0  # times the usual mean square
_HALF, _EDGE = 0.5, 0.85  # of the cut-off; there the filter is felt


def log_bayes(
    H: Array,
    s: Array,
    precision: Array,
    lower: Array,
    made_at: Array | None = None,
) -> tuple[Array, Array]:
    """Log Bayes factor and gains with a Gaussian prior, cut at their lower bounds.

    Args:
        H: Normal matrix of the columns, in units of noise, shape (..., p, p).
        s: Its right-hand side, shape (..., p).
        precision: Inverse variance of each gain's prior, shape (..., p).
        lower: Smallest value of each gain, shape (..., p).
        made_at: The gains that the columns are of alone, shape (..., p): where the most
            probable ones are far off, these count instead.

    Returns:
        Logarithm of the evidence with the columns over that without, [nat], shape
        (...), and the most probable gains, shape (..., p).
    """
    unit = 1.0 / np.sqrt(precision)
    A = np.eye(s.shape[-1]) + unit[..., :, None] * H * unit[..., None, :]
    b, least = unit * s, lower * np.sqrt(precision)
    x = np.asarray(np.linalg.solve(A, b[..., None])[..., 0])
    for k in map(tuple, np.argwhere(np.any(x < least, axis=-1))):
        free = x[k] >= least[k]
        held = np.where(free, 0.0, least[k])
        if free.any():
            rest = b[k][free] - A[k][free] @ held
            held[free] = np.linalg.solve(A[k][np.ix_(free, free)], rest)
        x[k] = np.maximum(held, least[k])
    _, occam = np.linalg.slogdet(A)
    worth, gains = _quadratic(A, b, x) - 0.5 * occam, np.asarray(unit * x)
    if made_at is not None:
        far = (gains < _OWN * made_at) | (gains > made_at / _OWN)
        fixed = np.any(far, axis=-1)
        worth = np.where(fixed, _quadratic(H, s, made_at), worth)
        gains = np.where(fixed[..., None], made_at, gains)
    return np.asarray(worth), gains


def heavy_tailed(
    H: Array,
    s: Array,
    precision: Array,
    lower: Array,
    made_at: Array | None = None,
) -> tuple[Array, Array, Array]:
    """:func:`log_bayes` with a prior that may be wider by some decades, at a cost.

    Files hold placeholders, and drives of all sizes: what is usual is not known well.

    Returns:
        The logarithm of the evidence, [nat], shape (...), the most probable gains,
        shape (..., p), and how many times wider the prior is, shape (...).
    """
    wider = np.array(WIDER).reshape(-1, *[1] * s.ndim)
    worth, gains = log_bayes(H, s, precision / wider**2, lower, made_at)
    worth = worth - np.log(wider[..., 0])
    best = np.argmax(worth, axis=0)
    chosen = np.take_along_axis(gains, best[None, ..., None], axis=0)[0]
    return worth.max(axis=0), chosen, np.array(WIDER)[best]


def _quadratic(A: Array, b: Array, x: Array) -> Array:
    return np.asarray((b * x).sum(-1) - 0.5 * np.einsum("...k,...kl,...l", x, A, x))


def quiet(
    x: Array, row: NDArray[np.intp], rate: float, cutoff: float | None = None
) -> NDArray[np.bool_]:
    """Samples of a residual where it is as large as it usually is, shape (R,).

    Noise is alike at all times. Where some stretch holds many times what half of them
    hold at most, something has happened there. It shows best below the frequencies
    that noise of derivatives is of.

    Args:
        x: The residual, shape (R,).
        row: Place of each sample in time, shape (R,).
        rate: Samples per second, [Hz].
        cutoff: End of the band in which to look, [Hz]; all of it by default.
    """
    if cutoff is not None and len(x):
        full = np.zeros(row.max() + 1)
        full[row] = x
        x = butterworth(full, rate=rate, cutoff=cutoff)[row]
    stretch = row // round(_STRETCH * rate)
    count = np.bincount(stretch)
    mean = np.bincount(stretch, x**2) / np.maximum(count, 1)
    usual = np.median(mean[count > 0]) if len(x) else 0.0
    return np.asarray(mean[stretch] <= _EVENT * usual)


def loudness(x: Array, row: NDArray[np.intp], rate: float, cutoff: float) -> Array:
    """How many times its usual square noise is around each sample, at least 1, (R,).

    The upper half of the band tells: what has a cause is mostly in the lower one.

    Args:
        x: A residual, shape (R,).
        row: Place of each sample in time, shape (R,).
        rate: Samples per second, [Hz].
        cutoff: End of its band, [Hz].
    """
    if not len(row):
        return np.ones(0)
    first = row.min()
    full, known = np.zeros((2, row.max() - first + 1))
    full[row - first], known[row - first] = x, 1.0
    upper = known * (full - butterworth(full, rate=rate, cutoff=_HALF * cutoff))
    length = max(1, round(_STRETCH * rate))
    around, count = (
        uniform_filter1d(y, length, mode="constant")[row - first]
        for y in (upper**2, known)
    )
    mean = around / count
    return np.asarray(np.maximum(mean / max(np.median(mean), 1e-300), 1.0))


def coloured(x: Array, row: NDArray[np.intp], rate: float, cutoff: float) -> float:
    """Squares of a residual in the lower half of its band beyond those of the upper.

    Noise of a sensor is as strong at all frequencies, and that of derivatives is
    stronger at the upper ones; what is stronger at the lower ones is no noise.

    Args:
        x: The residual, shape (R,).
        row: Place of each sample in time, shape (R,), ascending.
        rate: Samples per second, [Hz].
        cutoff: End of its band, [Hz].
    """
    power, f = _spectrum(x, row, rate)
    lower, upper = power[f < _HALF * cutoff], _upper(power, f / cutoff)
    return float(lower.sum() - len(lower) * upper.mean()) if len(upper) else 0.0


def most_noise(x: Array, row: NDArray[np.intp], rate: float, cutoff: float) -> float:
    """Mean square of a signal's noise at most, as its upper half band has it.

    Args:
        x: The signal, shape (R,).
        row: Place of each sample in time, shape (R,), ascending.
        rate: Samples per second, [Hz].
        cutoff: End of its band, [Hz].
    """
    power, f = _spectrum(x, row, rate)
    upper = _upper(power, f / cutoff)
    return float(np.sum(f < cutoff) * upper.mean() / len(x)) if len(upper) else 0.0


def _spectrum(x: Array, row: NDArray[np.intp], rate: float) -> tuple[Array, Array]:
    """Squares of a residual at each frequency of both signs, and these, [Hz]."""
    full = np.zeros(row[-1] - row[0] + 1)
    full[row - row[0]] = x
    power = 2 * np.abs(np.fft.rfft(full)) ** 2 / len(full)
    power[0] /= 2  # a constant has one sign only
    return power, np.asarray(np.fft.rfftfreq(len(full), 1.0 / rate))


def _upper(power: Array, f: Array) -> Array:
    return power[(f >= _HALF) & (f < _EDGE)]
