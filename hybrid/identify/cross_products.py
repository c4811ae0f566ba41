"""Cross-products of all columns and torques: all that least squares needs of the data.

They are accumulated once, block by block; estimators, intervals and held-out errors
then never touch a sample again, and memory does not grow with the length of the logs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

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
        counts: Samples of each block, shape (B,).
        recording: Which recording each block is from, shape (B,).
    """

    problem: Problem
    blocks: Array
    counts: Array
    recording: Array

    @cached_property
    def total(self) -> Array:
        """Sum over all blocks, shape (P, P)."""
        return np.asarray(self.blocks.sum(axis=0))

    @property
    def samples(self) -> int:
        """Samples per joint in all blocks."""
        return int(self.counts.sum())

    def some(self, chosen: Array) -> CrossProducts:
        """Only some blocks, by index or mask."""
        return replace(
            self,
            blocks=self.blocks[chosen],
            counts=self.counts[chosen],
            recording=self.recording[chosen],
        )

    def merged(self, factor: int) -> CrossProducts:
        """Blocks of one recording merged, ``factor`` neighbours at a time."""
        if factor == 1:
            return self
        label, last, seen = np.zeros(len(self.counts), dtype=int), -1, {}
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

    def rms(self, theta: Array) -> Array:
        """Residual RMS of each joint, shape (n,), [N·m]."""
        squares = np.diag(self.residual_products(theta)) / self.samples
        return np.sqrt(np.clip(squares, 0.0, None))


def accumulate(
    problem: Problem,
    motions: Sequence[Motion],
    *,
    cutoff: float,
    known: Sequence[Array] | None = None,
) -> CrossProducts:
    """Cross-products over motions, columns and torque filtered alike.

    Args:
        problem: Unknowns and layout.
        motions: Motions at full rate.
        cutoff: Cut-off of the filter of columns and torque, [Hz]; inf for none.
        known: Torque already explained, to subtract, shape (N, n) for each motion.

    Returns:
        Cross-products in at most 256 blocks.
    """
    seconds = sum(m.t[-1] - m.t[0] for m in motions)
    block_seconds = max(_BLOCK_SECONDS, seconds / _MOST_BLOCKS * 1.2)
    blocks: list[Array] = []
    counts: list[int] = []
    recording: list[int] = []
    for r, motion in enumerate(motions):
        if known is not None:
            motion = replace(motion, tau=motion.tau - known[r])
        sums, count = _one_motion(problem.rows, motion, cutoff, block_seconds)
        blocks += sums
        counts += count
        recording += [r] * len(count)
    return CrossProducts(
        problem, np.array(blocks), np.array(counts), np.array(recording)
    )


def _one_motion(
    rows: Rows, motion: Motion, cutoff: float, block_seconds: float
) -> tuple[list[Array], list[int]]:
    sampler = Sampler.for_rate(motion.rate, cutoff)
    length = max(1, round(block_seconds * motion.rate / sampler.factor))
    blocks: dict[int, Array] = {}
    counts: dict[int, int] = {}
    for first, D in sampled_chunks(rows, motion, sampler):
        mask = motion.mask[:: sampler.factor][first : first + D.shape[1]]
        index = (first + np.arange(D.shape[1])) // length
        for block in np.unique(index):
            part = D[:, (index == block) & mask]
            if part.shape[1] == 0:
                continue
            blocks[block] = blocks.get(block, 0.0) + part @ part.T
            counts[block] = counts.get(block, 0) + part.shape[1]
    order = sorted(blocks)
    return [blocks[b] for b in order], [counts[b] for b in order]


def sampled_chunks(rows: Rows, motion: Motion, sampler: Sampler):  # type: ignore[no-untyped-def]
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
