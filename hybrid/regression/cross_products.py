"""Cross-products of all columns and torques: all that least squares needs of the data.

They are accumulated once, block by block; estimators, intervals and held-out errors
then never touch a sample again, and memory does not grow with the length of the logs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.errors import IdentificationError
from hybrid.regression.problem import Problem, part
from hybrid.regression.scores import Scores, Scoring, runs_of
from hybrid.signals import Motion, Sampler

_CHUNK = 16384  # samples worked on at a time, at full rate
_MOST_BLOCKS = 96
_BLOCK_SECONDS = 0.25
_GRADIENT_MARGIN = 16  # samples that numerical derivatives need on both sides

# Index of the first decimated sample, decimated rows (P, M), and those at full rate.
Chunks = Iterator[tuple[int, Array, Array]]


@dataclass(frozen=True)
class CrossProducts:
    """Sums over the samples of each block.

    Attributes:
        problem: Unknowns and layout of the rows.
        blocks: Rows times rows transposed, per block in time, shape (B, P, P).
        counts: Samples of each block in which both joints moved, shape (B, n, n).
        recording: Which recording each block is from, shape (B,).
        fold: Part of the data each block belongs to, for cross-validation, shape (B,).
        scores: The same sums of each joint alone, unfiltered, to score on.
    """

    problem: Problem
    blocks: Array
    counts: Array
    recording: NDArray[np.intp]
    fold: NDArray[np.intp]
    scores: Scores | None = None

    @cached_property
    def total(self) -> Array:
        """Sum over all blocks, shape (P, P)."""
        return np.asarray(self.blocks.sum(axis=0))

    @cached_property
    def folds(self) -> Array:
        """Sums over the blocks of each fold, shape (F, P, P)."""
        return self.weighted(np.ones(len(self.fold)))

    def weighted(self, share: Array) -> Array:
        """Sums over the blocks of each fold, each with a weight, shape (F, P, P).

        Args:
            share: Weight of each block, shape (B,).
        """
        parts = [self.fold == k for k in range(int(self.fold.max()) + 1)]
        return np.array([np.tensordot(share[x], self.blocks[x], axes=1) for x in parts])

    @property
    def samples(self) -> int:
        """Samples of the joint that moved most."""
        return int(np.diag(self.counts.sum(axis=0)).max())

    def normal(self, weight: Array, sums: Array | None = None) -> tuple[Array, Array]:
        """Normal equations A theta = b for a weight across joints.

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
        for i, left in enumerate(problem.support):
            rows = slice(problem.offsets[i], problem.offsets[i] + len(left))
            for k, right in enumerate(problem.support):
                if weight[i, k] == 0:
                    continue
                start = problem.offsets[k]
                columns = slice(start, start + len(right))
                A[..., left[:, None], right] += weight[i, k] * sums[..., rows, columns]
                b[..., left] += weight[i, k] * sums[..., rows, start + len(right)]
        return A, b

    def leaves(self, theta: Array) -> Array:
        """Map from rows to what a solution leaves of each joint's torque, (P, n).

        Args:
            theta: Unknowns, shape (p,).
        """
        problem = self.problem
        C = np.zeros((problem.offsets[-1], len(problem.support)))
        for i, support in enumerate(problem.support):
            start = problem.offsets[i]
            C[start : start + len(support), i] = -theta[support]
            C[start + len(support), i] = 1.0
        return C

    def residual_products(self, theta: Array, sums: Array | None = None) -> Array:
        """Sum of residuals times residuals across joints, shape (..., n, n), [N²·m²].

        Args:
            theta: Unknowns, shape (p,).
            sums: Cross-products to use, shape (..., P, P); all blocks by default.
        """
        C = self.leaves(theta)
        return np.asarray(C.T @ (self.total if sums is None else sums) @ C)


def accumulate(
    problem: Problem,
    motions: Sequence[Motion],
    *,
    cutoff: float,
    standing: Array,
    folds: Sequence[NDArray[np.intp]] | None = None,
    blocks: Sequence[NDArray[np.intp]] | None = None,
    chunks: Callable[[Problem, Motion], Chunks] | None = None,
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
        blocks: Block of every sample to score on, shape (N,) for each motion; each lies
            in one fold.
        chunks: Where the rows of a motion come from; see :func:`sampled_chunks`.

    Returns:
        Cross-products in some 100 blocks at most.
    """
    seconds = sum(m.t[-1] - m.t[0] for m in motions)
    block_seconds = max(_BLOCK_SECONDS, seconds / _MOST_BLOCKS * 1.2)
    scoring = (
        None if blocks is None or folds is None else Scoring(problem, blocks, folds)
    )
    found: list[tuple[int, int, Array, Array]] = []
    for r, motion in enumerate(motions):
        fold = folds[r] if folds is not None else np.zeros(len(motion.t), dtype=int)
        sampler = Sampler.for_rate(motion.rate, cutoff)
        own = (
            chunks(problem, motion)
            if chunks
            else sampled_chunks(partial(rows_of, problem, motion), fold.size, sampler)
        )
        length = max(1, round(block_seconds * motion.rate / sampler.factor))
        sums = _one_motion(
            problem, motion, fold, standing, sampler, length, own, scoring, r
        )
        found += [(r, key[1], *x) for key, x in sorted(sums.items())]
    if not found:
        raise IdentificationError(
            "no usable sample: every one is masked, or no joint moves"
        )
    of, fold_of, both, counts = zip(*found, strict=True)
    return CrossProducts(
        problem,
        np.array(both),
        np.array(counts),
        np.array(of),
        np.array(fold_of),
        None if scoring is None else scoring.scores,
    )


def _one_motion(
    problem: Problem,
    motion: Motion,
    fold: NDArray[np.intp],
    standing: Array,
    sampler: Sampler,
    length: int,
    chunks: Chunks,
    scoring: Scoring | None,
    number: int,
) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Sums and counts by block in time, of some decimated samples, and fold."""
    sizes = np.diff(problem.offsets)
    found: dict[tuple[int, int], tuple[Array, Array]] = {}
    moves = ((np.abs(motion.v) > standing) & motion.mask[:, None]).T.astype(float)
    for first, D, raw in chunks:
        if scoring is not None:
            here = slice(first * sampler.factor, first * sampler.factor + raw.shape[1])
            scoring.add(number, here, raw, moves[:, here])
        samples = slice(first, first + D.shape[1])
        moving = moves[:, :: sampler.factor][:, samples]
        if not moving.all():
            D *= np.repeat(moving, sizes, axis=0)
        block = (first + np.arange(D.shape[1])) // length
        own = fold[:: sampler.factor][samples]
        for start, stop in runs_of(block, own):
            part, both = D[:, start:stop], moving[:, start:stop]
            if not both.any():
                continue
            key = int(block[start]), int(own[start])
            before = found.get(key, (0.0, 0.0))
            found[key] = (before[0] + part @ part.T, before[1] + both @ both.T)
    return found


def rows_of(problem: Problem, motion: Motion, here: slice) -> Array:
    """:meth:`Problem.rows` of some consecutive samples of a motion."""
    return problem.rows(part(motion, here))


def sampled_chunks(
    rows: Callable[[slice], Array],
    total: int,
    sampler: Sampler,
    filtered: Callable[[slice, Array], Array] | None = None,
) -> Chunks:
    """Rows evaluated at full rate, filtered and decimated, a chunk at a time.

    Chunks overlap by as much as the filter reaches, so the result is that of one piece.

    Args:
        rows: From consecutive samples, as a slice, to rows of shape (P, N).
        total: Number of samples.
        sampler: Filter and decimation.
        filtered: From the same samples and their rows to rows that were passed through
            the sampler, if some are known already.

    Yields:
        Index of the first decimated sample, the decimated rows, shape (P, M), and the
        rows at full rate that they come from, shape (P, samples).
    """
    factor = sampler.factor
    margin = -(-max(sampler.margin, _GRADIENT_MARGIN) // factor) * factor
    chunk = max(_CHUNK, 4 * margin) // factor * factor
    for start in range(0, total, chunk):
        before = max(0, start - margin)
        after = min(total, start + chunk + margin)
        stop = min(total, start + chunk)
        here = slice(before, after)
        full = rows(here)
        D = filtered(here, full) if filtered else sampler(full, axis=1)
        skip = (start - before) // factor
        count = -(-(stop - start) // factor)
        raw = full[:, start - before : stop - before]
        yield start // factor, D[:, skip : skip + count], raw
