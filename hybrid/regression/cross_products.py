"""Cross-products of columns and torques: the sufficient statistics of least squares.

They are accumulated once, for each block in time. Estimators, intervals and held-out
errors need no samples after that, so memory does not grow with the length of the logs.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.regression.chunk import Chunk, chunks_along
from hybrid.regression.problem import Problem
from hybrid.signals import Motion, Sampler

_MOST_BLOCKS = 96
_BLOCK_SECONDS = 0.25  # shortest block


@dataclass(frozen=True)
class Scores:
    """Sums of products of the unfiltered rows of each joint, over scoring blocks.

    Attributes:
        sums: Rows times rows transposed of each joint, summed over each block, shape
            (B, d, d) each.
        fold: Cross-validation fold of each block, shape (B,).
    """

    sums: tuple[Array, ...]
    fold: NDArray[np.intp]

    @classmethod
    def empty(
        cls,
        sizes: Sequence[int],
        blocks: Sequence[NDArray[np.intp]],
        folds: Sequence[NDArray[np.intp]],
    ) -> Self:
        """Sums of nothing.

        Args:
            sizes: Number of rows of each joint.
            blocks: Block of every sample, in one fold each, shape (N,) for each motion.
            folds: Fold of every sample, shape (N,) for each motion.
        """
        label, first = np.unique(np.concatenate(blocks), return_index=True)
        count = 1 + int(label.max())
        fold = np.zeros(count, dtype=np.intp)
        fold[label] = np.concatenate(folds)[first]
        return cls(tuple(np.zeros((count, d, d)) for d in sizes), fold)

    def add(self, block: NDArray[np.intp], D: Array, moving: NDArray[np.bool_]) -> None:
        """Add rows of some samples.

        Args:
            block: Block of each sample, shape (N,).
            D: Rows of all joints, shape (P, N).
            moving: Whether each joint moves; it does not count where it stands, (n, N).
        """
        own = np.split(D, np.cumsum([x.shape[1] for x in self.sums])[:-1])
        for sums, rows, moves in zip(self.sums, own, moving, strict=True):
            for start, stop in runs_of(block, moves.astype(int)):
                if moves[start]:
                    part = rows[:, start:stop]
                    sums[block[start]] += part @ part.T

    def squares(self, theta: Array, support: Sequence[NDArray[np.intp]]) -> Array:
        """Squared residuals of each block by the solution without its fold, (B, n).

        Args:
            theta: Solutions without each fold, shape (F, p).
            support: Unknown of each row of a joint but the last, its torque.
        """
        own = theta[self.fold]  # (B, p)
        found = np.empty((len(own), len(self.sums)))
        for i, (sums, used) in enumerate(zip(self.sums, support, strict=True)):
            c = np.concatenate([-own[:, used], np.ones((len(own), 1))], axis=1)
            found[:, i] = np.einsum("bk,bkl,bl->b", c, sums, c)
        return np.maximum(found, 0.0)


@dataclass(frozen=True)
class CrossProducts:
    """Sums of the rows of a problem over the samples of each block in time.

    Attributes:
        problem: The unknowns.
        blocks: Rows times rows transposed, summed over each block, shape (B, P, P).
        counts: Samples of each block in which both joints moved, shape (B, n, n).
        recording: Index of the recording of each block, shape (B,).
        fold: Cross-validation fold of each block, shape (B,).
        scores: Sums of unfiltered rows, for held-out errors.
    """

    problem: Problem
    blocks: Array
    counts: Array
    recording: NDArray[np.intp]
    fold: NDArray[np.intp]
    scores: Scores | None

    @cached_property
    def total(self) -> Array:
        """Sum over all blocks, shape (P, P)."""
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def folds(self) -> Array:
        """Sums over the blocks of each fold, shape (F, P, P)."""
        last = max(x.fold.max() for x in (self, self.scores) if x)
        member = np.arange(last + 1)[:, None] == self.fold
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
        """Normal equations A·theta = b for a weight matrix across joints.

        Args:
            weight: Inverse noise covariance, shape (n, n).
            sums: Cross-products to use, shape (..., P, P); all blocks by default.

        Returns:
            A, shape (..., p, p), and b, shape (..., p).
        """
        sums = self.total if sums is None else sums
        problem, many = self.problem, sums.shape[:-2]
        A = np.zeros((*many, problem.size, problem.size))
        b = np.zeros((*many, problem.size))
        parts = [slice(x, y) for x, y in pairwise(self.problem.offsets)]
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
        """Squared residuals of each block by the solution without its fold, (B, n).

        Args:
            theta: Solutions without each fold, shape (F, p).
        """
        assert self.scores is not None
        return self.scores.squares(theta, self.problem.support)


def accumulate(
    problem: Problem,
    motions: Sequence[Motion],
    *,
    cutoff: float,
    standing: Array,
    folds: Sequence[NDArray[np.intp]] | None = None,
    blocks: Sequence[NDArray[np.intp]] | None = None,
    chunks: Sequence[Iterable[Chunk]] | None = None,
) -> CrossProducts:
    """Sums of products of rows along motions, columns and torque filtered identically.

    The rows of a joint are left out while it stands still: any friction below the
    break-away torque may hold it then, so its torque tells nothing.

    Args:
        problem: The unknowns.
        motions: Motions at full rate.
        cutoff: Cut-off of the filter of columns and torque, [Hz]; inf for none.
        standing: Speed of each joint below which it stands, shape (n,), [rad/s].
        folds: Fold of every sample, shape (N,) for each motion.
        blocks: Scoring block of every sample, shape (N,) for each motion; each block
            lies in one fold.
        chunks: Chunks of each motion, if they were cut before.

    Returns:
        Sums in about 100 blocks at most.

    Raises:
        IdentificationError: Every sample is masked, or no joint moves.
    """
    seconds = sum(m.t[-1] - m.t[0] for m in motions)
    block_seconds = max(_BLOCK_SECONDS, seconds / _MOST_BLOCKS * 1.2)
    sizes = np.diff(problem.offsets).tolist()
    scores = Scores.empty(sizes, blocks, folds) if blocks and folds else None
    # Products and counts by recording, block and fold.
    found: dict[tuple[int, int, int], tuple[Array, Array]] = {}
    for r, motion in enumerate(motions):
        sampler = Sampler.for_rate(motion.rate, cutoff)
        length = max(1, round(block_seconds * motion.rate / sampler.factor))
        fold = folds[r] if folds else np.zeros(len(motion.t), dtype=np.intp)
        moves = ((np.abs(motion.v) > standing) & motion.mask[:, None]).T
        for chunk in chunks[r] if chunks else chunks_along(motion, sampler):
            first, (D, raw) = chunk.first, chunk.rows(problem)
            here = slice(first * sampler.factor, first * sampler.factor + raw.shape[1])
            if scores and blocks:
                scores.add(blocks[r][here], raw, moves[:, here])
            moving = moves[:, here][:, :: sampler.factor].astype(float)
            D *= np.repeat(moving, sizes, axis=0)
            block = (first + np.arange(D.shape[1])) // length
            own = sampler.keep(fold[here])
            for start, stop in runs_of(block, own):
                x, there = D[:, start:stop], moving[:, start:stop]
                if there.any():
                    key = r, int(block[start]), int(own[start])
                    products, counts = found.get(key, (0.0, 0.0))
                    found[key] = products + x @ x.T, counts + there @ there.T
    if not found:
        raise IdentificationError(
            "no usable sample: every one is masked, or no joint moves"
        )
    keys = sorted(found)
    recording, _, block_fold = np.array(keys).T
    products, counts = map(np.array, zip(*(found[k] for k in keys), strict=True))
    return CrossProducts(problem, products, counts, recording, block_fold, scores)


def runs_of(*labels: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of equal labels."""
    steps = np.sum([np.abs(np.diff(x, prepend=-1)) for x in labels], axis=0)
    return list(pairwise([*np.flatnonzero(steps), len(labels[0])]))
