"""How long a residual remembers: samples that are worth an independent one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array


def memory(x: Array, row: NDArray[np.intp]) -> float:
    """Integrated autocorrelation of a residual: samples for an independent one.

    Args:
        x: The residual, shape (R,).
        row: Place of each sample in time, shape (R,), ascending.

    Source: Geyer 1992, doi 10.1214/ss/1177011137 (pairs of lags while positive).
    """
    power = x @ x
    if power == 0 or len(x) < 8:
        return 1.0
    full = np.zeros(row[-1] - row[0] + 1)
    full[row - row[0]] = x
    seen = np.zeros(len(full))
    seen[row - row[0]] = 1.0
    size = 1 << int(np.ceil(np.log2(2 * len(full))))
    lagged = np.fft.irfft(np.abs(np.fft.rfft(full, size)) ** 2, size)[: len(full) // 2]
    pairs = np.fft.irfft(np.abs(np.fft.rfft(seen, size)) ** 2, size)[: len(full) // 2]
    correlation = lagged / np.maximum(pairs, 1.0) / (power / len(x))
    even = correlation[: len(correlation) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = int(np.argmax(even < 0)) if np.any(even < 0) else len(even)
    return float(max(1.0, 2 * even[:stop].sum() - 1.0))
