"""Noise of a joint as a process: what of a residual follows from the samples before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import solve_banded

from hybrid.arrays import Array

LAGS = 16  # that noise is known at
_UPPER = 0.5, 0.85  # of the band: there is little else than noise
_LEAST = 1e-6  # of the variance


class Noise:
    """A Gaussian process of a joint's samples, an autoregression with holes.

    What is whitened is independent from sample to sample, of variance one. As a run of
    samples begins, the few before are all that is known.

    Args:
        covariance: Covariance at lags 0 to p, shape (p + 1,), [N²·m²].
        follows: Whether a sample is the next one after the one before it, shape (R,).

    Source: Durbin 1960, doi 10.2307/1401322 (predictors of rising order).
    """

    def __init__(self, covariance: Array, follows: NDArray[np.bool_]) -> None:
        predictors = _predictors(covariance)  # (p + 1, p + 1)
        count, p = len(follows), len(covariance) - 1
        start = np.where(follows, 0, np.arange(count))
        since = np.arange(count) - np.maximum.accumulate(start)
        by_row = predictors[np.minimum(since, p)]  # (R, p + 1)
        self._bands = np.zeros((p + 1, count))  # as SciPy stores lower bands
        for k in range(min(p + 1, count)):
            self._bands[k, : count - k] = by_row[k:, k]
        shape = count, count
        bands = sparse.dia_array((self._bands, -np.arange(p + 1)), shape=shape)
        self._matrix = bands.tocsr()

    def whiten(self, x: Array) -> Array:
        """Samples as independent ones, shape (R, ...) each."""
        return np.asarray(self._matrix @ x)

    def colour(self, x: Array) -> Array:
        """The inverse of :meth:`whiten`."""
        below = len(self._bands) - 1
        return np.asarray(solve_banded((below, 0), self._bands, x))


def autocovariance(x: Array, row: NDArray[np.intp], lags: int) -> Array:
    """Covariance of a signal with holes at lags 0 to p, shape (p + 1,).

    Args:
        x: The signal, shape (R,).
        row: Place of each sample in time, shape (R,), ascending.
        lags: Largest lag p.
    """
    full = np.zeros(row[-1] - row[0] + 1 + lags)
    full[row - row[0]] = x
    end = len(full) - lags
    return np.array([full[:end] @ full[k : end + k] for k in range(lags + 1)]) / len(x)


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


def floored(covariance: Array, cutoff: float) -> Array:
    """Covariance of a filtered process, as if its stop band had as much as its band.

    Args:
        covariance: At lags from zero on, shape (p + 1,).
        cutoff: End of its band, in cycles per sample.
    """
    p = len(covariance) - 1
    lag = np.arange(1, p + 1)
    f = cutoff * np.linspace(*_UPPER, 20)
    taper = 1.0 - lag / (p + 1)  # so that no density is below zero
    density = covariance[0] + 2 * np.cos(2 * np.pi * np.outer(f, lag)) @ (
        taper * covariance[1:]
    )
    out = covariance.copy()
    out[0] += max(float(density.mean()), _LEAST * covariance[0], 1e-300)
    return out
