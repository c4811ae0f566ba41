"""Which samples are learnt from, and which are kept for scoring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import block_seconds

_FAR_LARGER = 10.0  # times the mean squares


def split(gap: Gap) -> NDArray[np.bool_]:
    """Samples to learn from, shape (M,); the others are for scoring only.

    Every fourth trajectory is kept for scoring; of fewer than four, every fourth block
    of time, less a sixth at both of its ends, which is used for nothing. It is others
    if those alone hold what is far larger than anything that is left to learn from.
    """
    part, count = gap.trajectory, gap.trajectory.max() + 1
    masks = [part % 4 != k for k in (3, 2, 1, 0)]
    if count < 4:
        part = gap.fold * count + gap.trajectory
        # Not the same block of each: trajectories often end alike. Nor none at all.
        masks = [
            (gap.fold + turn * gap.trajectory + more) % 4 != 3
            for more in range(4) for turn in (1, 2, 0)
        ]  # fmt: skip
        masks = [x for x in masks if x.any() and not x.all()] or masks[:1]
    most = _unusual(gap, part)
    alone = [most[~x].max(initial=0.0) / most[x].max(initial=1e-300) for x in masks]
    chosen = 0 if alone[0] < _FAR_LARGER else int(np.argmin(alone))
    return np.asarray(masks[chosen])


def _unusual(gap: Gap, part: NDArray[np.intp]) -> Array:
    """Mean squares of a sample's part over those of a usual one, shape (M,).

    Of the joint at which that is most.
    """
    parts, own = np.unique(part, return_inverse=True)
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    mean = np.stack([
        squares[own == k].sum(axis=0) / np.maximum(gap.moving[own == k].sum(axis=0), 1)
        for k in range(len(parts))
    ])  # fmt: skip
    usual = np.maximum(np.median(mean, axis=0), 1e-300)
    return np.asarray((mean / usual).max(axis=1)[own])


def between(gap: Gap, learn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Samples too near to those learnt from to be scored."""
    reach = round(block_seconds(gap.motions) / 6 * gap.rate)
    near = np.convolve(learn, np.ones(2 * reach + 1), mode="same") > 0
    apart = np.ones(len(learn), dtype=bool)
    if gap.trajectory.max() < 3:
        apart = ~near
    return apart
