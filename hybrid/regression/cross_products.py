"""Cross-products of columns and torques: the sufficient statistics of least squares.

They are accumulated once, for each block in time. Estimators, intervals and held-out
errors need no samples after that, so memory does not grow with the length of the logs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.errors import IdentificationError
from hybrid.regression.data import Data
from hybrid.regression.problem import Problem

_MOST_BLOCKS = 96
_BLOCK_SECONDS = 0.25  # shortest block


@dataclass(frozen=True)
class CrossProducts:
    """Sums of the rows of a problem over the samples of each block in time.

    Attributes:
        problem: The unknowns.
        data: The motions.
        blocks: Rows times rows transposed, summed over each block, shape (B, P, P).
        counts: Samples of each block in which both joints moved, shape (B, n, n).
        recording: Index of the recording of each block, shape (B,).
        fold: Cross-validation fold of each block, shape (B,).
        unfiltered: The same sums of the unfiltered rows of each joint over the blocks
            of the data, for held-out errors, shape (B', d, d) each.
    """

    problem: Problem
    data: Data
    blocks: Array
    counts: Array
    recording: Index
    fold: Index
    unfiltered: tuple[Array, ...]

    @cached_property
    def total(self) -> Array:
        """Sum over all blocks, shape (P, P)."""
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def folds(self) -> Array:
        """Sums over the blocks of each fold, shape (F, P, P)."""
        member = np.arange(self.data.fold_count)[:, None] == self.fold
        return np.asarray(np.tensordot(1.0 * member, self.blocks, axes=1))

    def shared(self, share: Array) -> CrossProducts:
        """The same with a weight of each block, shape (B,)."""
        if share.min() == 1.0:
            return self
        each = share[:, None, None]
        return replace(self, blocks=each * self.blocks, counts=each * self.counts)

    @property
    def samples(self) -> int:
        """Number of samples of the joint that moved most."""
        return int(np.diag(self.counts.sum(axis=0)).max())

    def normal(self, weight: Array, sums: Array | None = None) -> tuple[Array, Array]:
        """Normal equations A·theta = b for an inverse noise covariance, shape (n, n).

        They are those of all blocks, or of other sums, shape (..., P, P). A has the
        shape (..., p, p), and b (..., p).
        """
        sums = self.total if sums is None else sums
        problem, many = self.problem, sums.shape[:-2]
        A = np.zeros((*many, problem.size, problem.size))
        b = np.zeros((*many, problem.size))
        parts = [slice(x, y) for x, y in pairwise(problem.offsets)]
        for i, k in zip(*np.nonzero(weight), strict=True):
            left, right = problem.support[i], problem.support[k]
            own = weight[i, k] * sums[..., parts[i], parts[k]]
            A[..., left[:, None], right] += own[..., :-1, :-1]
            b[..., left] += own[..., :-1, -1]
        return A, b

    def without_folds(self, weight: Array) -> tuple[Array, Array]:
        """Normal equations without each fold, shapes (F, p, p) and (F, p)."""
        return self.normal(weight, self.folds.sum(axis=0) - self.folds)

    def residual_products(self, theta: Array, sums: Array | None = None) -> Array:
        """Sum of products of residuals across joints, shape (..., n, n), [N²·m²].

        It is that of all blocks, or of other sums, shape (..., P, P).
        """
        C = np.zeros((self.problem.offsets[-1], len(self.problem.support)))
        for i, support in enumerate(self.problem.support):
            own = slice(*self.problem.offsets[i : i + 2])
            C[own, i] = [*-theta[support], 1.0]
        return np.asarray(C.T @ (self.total if sums is None else sums) @ C)

    def held_out_squares(self, theta: Array) -> Array:
        """Squared residuals by the solution without the fold of each block.

        Solutions have shape (F, p), and squares of the blocks of the data (B', n).
        """
        own, support = theta[self.data.block_folds], self.problem.support
        found = np.empty((len(own), len(support)))
        for i, (sums, used) in enumerate(zip(self.unfiltered, support, strict=True)):
            c = np.concatenate([-own[:, used], np.ones((len(own), 1))], axis=1)
            found[:, i] = np.einsum("bk,bkl,bl->b", c, sums, c)
        return np.maximum(found, 0.0)


def accumulate(problem: Problem, data: Data) -> CrossProducts:
    """Sums of products of rows along motions, columns and torque filtered identically.

    The rows of a joint are left out while it stands still: any friction below the
    break-away torque may hold it then, so its torque tells nothing.

    Returns:
        Sums in about 100 blocks at most.

    Raises:
        IdentificationError: Every sample is masked, or no joint moves.
    """
    seconds = sum(m.t[-1] - m.t[0] for m in data.motions)
    block_seconds = max(_BLOCK_SECONDS, seconds / _MOST_BLOCKS * 1.2)
    sizes, count = np.diff(problem.offsets).tolist(), len(data.block_folds)
    unfiltered = tuple(np.zeros((count, d, d)) for d in sizes)
    # Products and counts by recording, block and fold.
    found: dict[tuple[int, int, int], tuple[Array, Array]] = {}
    for r, motion in enumerate(data.motions):
        moves, sampler = data.moves(motion).T, data.sampler(motion.rate)
        for start, D, raw in data.rows(problem, motion):
            here = slice(start, start + raw.shape[1])
            _add_by_block(unfiltered, data.blocks[r][here], raw, moves[:, here])
            moving = moves[:, here][:, :: sampler.factor].astype(float)
            D *= np.repeat(moving, sizes, axis=0)
            length = max(1, round(block_seconds * motion.rate / sampler.factor))
            block = (start // sampler.factor + np.arange(D.shape[1])) // length
            own = sampler.keep(data.folds[r][here])
            for begin, stop in runs_of(block, own):
                x, there = D[:, begin:stop], moving[:, begin:stop]
                if there.any():
                    key = r, int(block[begin]), int(own[begin])
                    products, counts = found.get(key, (0.0, 0.0))
                    found[key] = products + x @ x.T, counts + there @ there.T
    if not found:
        raise IdentificationError(
            "no usable sample: every one is masked, or no joint moves"
        )
    keys = sorted(found)
    recording, _, block_fold = np.array(keys).T
    products, counts = map(np.array, zip(*(found[k] for k in keys), strict=True))
    return CrossProducts(
        problem, data, products, counts, recording, block_fold, unfiltered
    )


def _add_by_block(
    sums: tuple[Array, ...], block: Index, D: Array, moving: Mask
) -> None:
    """Add products of rows (P, N) to the blocks of their samples, where joints move."""
    parts = np.split(D, np.cumsum([x.shape[1] for x in sums])[:-1])
    for own, rows, moves in zip(sums, parts, moving, strict=True):
        for start, stop in runs_of(block, moves.astype(int)):
            if moves[start]:
                part = rows[:, start:stop]
                own[block[start]] += part @ part.T


def runs_of(*labels: Index) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of equal labels."""
    steps = np.sum([np.abs(np.diff(x, prepend=-1)) for x in labels], axis=0)
    return list(pairwise([*np.flatnonzero(steps), len(labels[0])]))
