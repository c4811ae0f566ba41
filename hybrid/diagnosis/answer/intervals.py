"""95 % intervals by the bootstrap over blocks of time, as samples are correlated."""

from collections.abc import Callable

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.answer.diagnosis import Interval, Shrink

_RESAMPLES = 400


def interval(
    statistic: Callable[[Index], Array],
    blocks: int,
    rng: np.random.Generator,
) -> Interval:
    """95 % interval of a share; 0 to 1 if there is a single block.

    ``statistic`` computes the share, shape (R,), from indices of the blocks in each
    resample, (R, blocks).
    """
    if blocks < 2:
        return 0.0, 1.0
    draws = statistic(rng.integers(blocks, size=(_RESAMPLES, blocks)))
    low, high = np.quantile(draws, [0.025, 0.975])
    return float(low), float(high)


def shrunk(squares: Array, count: int, unit: str, rng: np.random.Generator) -> Shrink:
    """RMS of a gap before and after, and the part removed with its interval.

    ``squares`` are sums over each block of time, before and after, shape (2, B), of
    ``count`` samples.
    """

    def removed(sums: Array) -> Array:
        before, after = sums
        whole = np.where(before > 0, before, np.inf)
        return np.asarray(1.0 - np.sqrt(after / whole))

    squares = squares[:, squares[0] > 0]
    whole = squares.sum(axis=1)
    before, after = np.sqrt(whole / max(count, 1)).tolist()
    return Shrink(
        before,
        after,
        float(removed(whole)) if before else 0.0,
        interval(lambda k: removed(squares[:, k].sum(axis=-1)), squares.shape[1], rng),
        unit=unit,
    )
