"""Estimate how many successive samples of a residual count as one independent one."""

import numpy as np

from hybrid.arrays import Array, Index


def autocorrelation_time(x: Array, row: Index) -> float:
    """Integrated autocorrelation time of a residual, in samples, 1 or more.

    Args:
        x: Residual, shape (R,).
        row: Time index of each sample, shape (R,), ascending.

    Source: Geyer 1992, doi 10.1214/ss/1177011137 (initial positive sequence).
    """
    power = x @ x
    if power == 0 or len(x) < 8:
        return 1.0
    series = np.zeros(row[-1] - row[0] + 1)
    series[row - row[0]] = x
    present = np.zeros(len(series))
    present[row - row[0]] = 1.0
    size, lags = 1 << int(np.ceil(np.log2(2 * len(series)))), len(series) // 2
    products = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)[:lags]
    counts = np.fft.irfft(np.abs(np.fft.rfft(present, size)) ** 2, size)[:lags]
    correlation = products / np.maximum(counts, 1.0) / (power / len(x))
    pairs = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    end = int(np.argmax(pairs < 0)) if np.any(pairs < 0) else len(pairs)
    return float(max(1.0, 2 * pairs[:end].sum() - 1.0))
