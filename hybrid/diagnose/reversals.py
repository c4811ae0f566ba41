"""What the torque does while a joint reverses: dry friction passes through zero."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hybrid.diagnose.gap import Gap
from hybrid.diagnose.model import Model
from hybrid.diagnose.term import Term

_STANDING = 0.02  # of the highest speed
_REACH = 1.0  # over the cut-off: how far the filter carries a reversal
_FEWEST = 3  # each way
_SURELY = 3.0  # deviations
_TELLING = 0.05  # of the torque: with a larger deviation it might be gone unseen


def vanishes(model: Model, term: Term) -> bool | None:
    """Whether a torque that hardly changes is gone where its joint reverses.

    Friction may go through zero there; what the log is shifted by does not.

    Args:
        model: All terms.
        term: That torque: one level [N·m] at one joint.

    Returns:
        Nothing if there are too few reversals to tell, or other things happen there.
    """
    (j,) = term.place[1]
    (level,) = model.evidence.solve(model.base()).of(term.index)
    height, deviation = dip(model.gap, j)
    if -np.sign(level) * height > _SURELY * deviation:
        return True
    return False if deviation < _TELLING * abs(level) else None


def dip(gap: Gap, j: int) -> tuple[float, float]:
    """What the gap of a joint is at its reversals more than just before and after.

    Half of the weight each is on those upwards and downwards: what follows the
    direction of motion cancels.

    Args:
        gap: The gap.
        j: Joint.

    Returns:
        The mean and its standard deviation, [N·m]; 0 and infinity if there are fewer
        than three either way.
    """
    found = [x for r in range(len(gap.motions)) for x in _reversals(gap, j, r)]
    height, way = np.array(found).reshape(-1, 2).T
    if min((way > 0).sum(), (way < 0).sum()) < _FEWEST:
        return 0.0, np.inf
    parts = [height[way > 0], height[way < 0]]
    scatter = sum(((x - x.mean()) ** 2).sum() for x in parts) / (len(way) - 2)
    spread = 0.5 * np.sqrt(scatter * sum(1.0 / len(x) for x in parts))
    return float(np.mean([x.mean() for x in parts])), float(spread)


def _reversals(gap: Gap, j: int, r: int) -> Iterator[tuple[float, float]]:
    """Height at each reversal of a motion, and its direction."""
    rows, sampler = np.flatnonzero(gap.trajectory == r), gap.samplers[r]
    left, v = gap.left[rows, j], gap.sampled.v[rows, j]
    usable = sampler.keep(gap.motions[r].mask)
    rate = gap.motions[r].rate / sampler.factor
    reach = max(int(np.ceil(_REACH / gap.cutoff * rate)), 1)
    fast = np.flatnonzero(np.abs(v) > _STANDING * np.abs(v).max())
    for before, after in zip(fast[:-1], fast[1:], strict=True):
        first, end = before + 1 - reach, after + reach
        side = (end - first) // 2
        low, high = first - side, end + side
        if v[before] * v[after] > 0 or low < 0 or high > len(v):
            continue
        whole = np.concatenate([v[before] * v[low:before], v[after] * v[after:high]])
        if usable[low:high].all() and (whole > 0).all():
            beside = left[low:first].mean() + left[end:high].mean()
            yield left[first:end].mean() - beside / 2, np.sign(v[after])
