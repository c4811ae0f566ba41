"""Split of the samples into a training set and a test set."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

from hybrid.arrays import Array
from hybrid.diagnosis.gap.gap import Gap
from hybrid.diagnosis.gap.measure import block_seconds

_FAR_LARGER = 10.0  # times, of mean squares


def split(gap: Gap) -> NDArray[np.bool_]:
    """Training samples, shape (M,); the others are the test set.

    Every fourth trajectory is for testing. Where there are fewer than four, it is every
    fourth block of time, less a part at both ends; see :func:`unseen_samples`. Another
    split is taken where the test set alone holds squares that are far larger than all
    of the training set.
    """
    part, count = gap.trajectory, gap.trajectory.max() + 1
    masks = [part % 4 != k for k in (3, 2, 1, 0)]
    if count < 4:
        part = gap.fold * count + gap.trajectory
        # Another block of each trajectory, as trajectories often end alike.
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
    """Mean squares of each sample's part over the median of all parts, shape (M,).

    The joint with the largest ratio counts.
    """
    parts, own = np.unique(part, return_inverse=True)
    squares = np.where(gap.moving, gap.left, 0.0) ** 2
    mean = np.stack([
        squares[own == k].sum(axis=0) / np.maximum(gap.moving[own == k].sum(axis=0), 1)
        for k in range(len(parts))
    ])  # fmt: skip
    usual = np.maximum(np.median(mean, axis=0), 1e-300)
    return np.asarray((mean / usual).max(axis=1)[own])


def unseen_samples(gap: Gap, learn: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Test samples beside given training samples, shape (M,).

    Whole trajectories are tested; blocks of one lose a sixth at both ends.
    """
    if gap.trajectory.max() >= 3:
        return ~learn
    reach = round(block_seconds(gap.motions) / 6 * gap.rate)
    return np.asarray(~binary_dilation(learn, np.ones(2 * reach + 1)))
