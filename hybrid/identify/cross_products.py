"""Cross-products of all columns and torques: all that least squares needs of the data.

They are accumulated once, block by block; estimators, intervals and held-out errors
then never touch a sample again, and memory does not grow with the length of the logs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import IdentificationError
from hybrid.identify.problem import Problem
from hybrid.robot.chain import Array
from hybrid.signals import Motion, Sampler

_CHUNK = 16384  # samples worked on at a time, at full rate
_MOST_BLOCKS = 256
_BLOCK_SECONDS = 0.25
_GRADIENT_MARGIN = 16  # samples that numerical derivatives need on both sides

Rows = Callable[[Motion], Array]


@dataclass(frozen=True)
class CrossProducts:
    """Sums over the samples of each block.

    Attributes:
        problem: Unknowns and layout of the rows.
        blocks: Rows times rows transposed, per block in time, shape (B, P, P).
        counts: Samples of each block in which both joints moved, shape (B, n, n).
        recording: Which recording each block is from, shape (B,).
        fold: Part of the data each block belongs to, for cross-validation, shape (B,).
    """

    problem: Problem
    blocks: Array
    counts: Array
    recording: NDArray[np.intp]
    fold: NDArray[np.intp]

    @cached_property
    def total(self) -> Array:
        """Sum over all blocks, shape (P, P)."""
        return np.asarray(self.blocks.sum(axis=0))

    @property
    def samples(self) -> int:
        """Samples of the joint that moved most."""
        return int(np.diag(self.counts.sum(axis=0)).max())

    def some(self, chosen: NDArray[np.bool_]) -> CrossProducts:
        """Only some blocks, by index or mask."""
        return replace(
            self,
            blocks=self.blocks[chosen],
            counts=self.counts[chosen],
            recording=self.recording[chosen],
            fold=self.fold[chosen],
        )

    def merged(self, factor: int) -> CrossProducts:
        """Blocks of one recording merged, ``factor`` neighbours at a time.

        Folds are given up.
        """
        if factor == 1:
            return self
        label, last = np.zeros(len(self.counts), dtype=int), -1
        seen: dict[int, int] = {}
        for b, r in enumerate(self.recording):
            position = seen[int(r)] = seen.get(int(r), -1) + 1
            if position % factor == 0:
                last += 1
            label[b] = last
        starts = np.flatnonzero(np.diff(label, prepend=-1))
        return replace(
            self,
            blocks=np.add.reduceat(self.blocks, starts),
            counts=np.add.reduceat(self.counts, starts),
            recording=self.recording[starts],
            fold=self.fold[starts],
        )

    def normal(self, weight: Array, sums: Array | None = None) -> tuple[Array, Array]:
        """Normal equations A theta = b for a weight across joints.

        Args:
            weight: Inverse noise covariance, shape (n, n).
            sums: Cross-products to use, shape (P, P); all blocks by default.

        Returns:
            A, shape (p, p), and b, shape (p,).
        """
        sums = self.total if sums is None else sums
        problem = self.problem
        A, b = np.zeros((problem.size, problem.size)), np.zeros(problem.size)
        for i, left in enumerate(problem.support):
            rows = slice(problem.offsets[i], problem.offsets[i] + len(left))
            for k, right in enumerate(problem.support):
                if weight[i, k] == 0:
                    continue
                start = problem.offsets[k]
                columns = slice(start, start + len(right))
                A[np.ix_(left, right)] += weight[i, k] * sums[rows, columns]
                b[left] += weight[i, k] * sums[rows, start + len(right)]
        return A, b

    def residual_products(self, theta: Array, sums: Array | None = None) -> Array:
        """Sum of residuals times residuals across joints, shape (..., n, n), [N²·m²].

        Args:
            theta: Unknowns, shape (p,).
            sums: Cross-products to use, shape (..., P, P); all blocks by default.
        """
        sums = self.total if sums is None else sums
        problem = self.problem
        C = np.zeros((problem.offsets[-1], len(problem.support)))
        for i, support in enumerate(problem.support):
            start = problem.offsets[i]
            C[start : start + len(support), i] = -theta[support]
            C[start + len(support), i] = 1.0
        return np.asarray(C.T @ sums @ C)

    def squares(self, theta: Array) -> Array:
        """Sum of each joint's squared residuals, shape (n,), [N²·m²]."""
        return np.clip(np.diag(self.residual_products(theta)), 0.0, None)

    @property
    def moving(self) -> Array:
        """Samples at which each joint moved, shape (n,)."""
        return np.maximum(np.diag(self.counts.sum(axis=0)), 1.0)


def accumulate(
    problem: Problem,
    motions: Sequence[Motion],
    *,
    cutoff: float,
    standing: Array,
    folds: Sequence[NDArray[np.intp]] | None = None,
    known: Sequence[Array] | None = None,
) -> CrossProducts:
    """Cross-products over motions, columns and torque filtered alike.

    A joint that stands still may be held by any friction below break-away, so its
    torque says nothing: its rows are left out while it stands.

    Args:
        problem: Unknowns and layout.
        motions: Motions at full rate.
        cutoff: Cut-off of the filter of columns and torque, [Hz]; inf for none.
        standing: Speed of each joint below which it stands, shape (n,), [rad/s].
        folds: Fold of every sample, shape (N,) for each motion.
        known: Filtered torque already explained, to subtract, shape (M, n) for the
            decimated samples of each motion, [N·m].

    Returns:
        Cross-products in some 256 blocks at most.
    """
    seconds = sum(m.t[-1] - m.t[0] for m in motions)
    block_seconds = max(_BLOCK_SECONDS, seconds / _MOST_BLOCKS * 1.2)
    found: list[tuple[int, int, Array, Array]] = []
    for r, motion in enumerate(motions):
        fold = folds[r] if folds is not None else np.zeros(len(motion.t), dtype=int)
        explained = None if known is None else known[r]
        blocks = _one_motion(
            problem, motion, fold, explained, cutoff, standing, block_seconds
        )
        found += [(r, key[1], *sums) for key, sums in sorted(blocks.items())]
    if not found:
        raise IdentificationError(
            "no usable sample: every one is masked, or no joint moves"
        )
    of, fold_of, sums, counts = zip(*found, strict=True)
    return CrossProducts(
        problem, np.array(sums), np.array(counts), np.array(of), np.array(fold_of)
    )


def _one_motion(
    problem: Problem,
    motion: Motion,
    fold: NDArray[np.intp],
    known: Array | None,
    cutoff: float,
    standing: Array,
    block_seconds: float,
) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Sums and counts by block in time and fold."""
    sampler = Sampler.for_rate(motion.rate, cutoff)
    length = max(1, round(block_seconds * motion.rate / sampler.factor))
    sizes = np.diff(problem.offsets)
    found: dict[tuple[int, int], tuple[Array, Array]] = {}
    everywhere = moving_samples(motion, sampler, standing)
    for first, D in sampled_chunks(problem.rows, motion, sampler):
        samples = slice(first, first + D.shape[1])
        moving = everywhere[samples].T.astype(float)
        if known is not None:
            D[np.array(problem.offsets[1:]) - 1] -= known[samples].T
        D *= np.repeat(moving, sizes, axis=0)
        block = (first + np.arange(D.shape[1])) // length
        own = fold[:: sampler.factor][samples]
        starts = np.flatnonzero(np.diff(block, prepend=-1) | np.diff(own, prepend=-1))
        for start, stop in pairwise([*starts, D.shape[1]]):
            part, both = D[:, start:stop], moving[:, start:stop]
            if not both.any():
                continue
            key = int(block[start]), int(own[start])
            before = found.get(key, (0.0, 0.0))
            found[key] = (before[0] + part @ part.T, before[1] + both @ both.T)
    return found


def moving_samples(
    motion: Motion, sampler: Sampler, standing: Array
) -> NDArray[np.bool_]:
    """Decimated samples at which each joint moves and the mask allows, (M, n)."""
    moving = np.abs(motion.v[:: sampler.factor]) > standing
    return np.asarray(moving & sampler.keep(motion.mask)[:, None])


def sampled_chunks(
    rows: Rows, motion: Motion, sampler: Sampler
) -> Iterator[tuple[int, Array]]:
    """Rows evaluated at full rate, filtered and decimated, a chunk at a time.

    Chunks overlap by as much as the filter reaches, so the result is that of one piece.

    Args:
        rows: From a motion of N samples to rows of shape (P, N).
        motion: Motion at full rate.
        sampler: Filter and decimation.

    Yields:
        Index of the first decimated sample, and the decimated rows, shape (P, M).
    """
    factor, total = sampler.factor, len(motion.t)
    margin = -(-max(sampler.margin, _GRADIENT_MARGIN) // factor) * factor
    chunk = max(_CHUNK, 4 * margin) // factor * factor
    for start in range(0, total, chunk):
        before = max(0, start - margin)
        after = min(total, start + chunk + margin)
        D = sampler(rows(part(motion, slice(before, after))), axis=1)
        skip = (start - before) // factor
        count = -(-(min(total, start + chunk) - start) // factor)
        yield start // factor, D[:, skip : skip + count]


def part(motion: Motion, samples: slice) -> Motion:
    """Some consecutive samples of a motion."""
    warm = None if motion.temperature is None else motion.temperature[samples]
    return replace(
        motion,
        t=motion.t[samples],
        q=motion.q[samples],
        v=motion.v[samples],
        a=motion.a[samples],
        tau=motion.tau[samples],
        mask=motion.mask[samples],
        temperature=warm,
    )
