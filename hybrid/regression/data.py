"""Data of a fit: motions, cross-validation folds, blocks, filter and standstill."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.effects import Scale
from hybrid.errors import RecordingError
from hybrid.regression.problem import Problem, part
from hybrid.signals import Motion, Sampler

_FEWEST_BLOCKS = 48  # over which the gain of a term is averaged
_CHUNK = 16384  # samples processed at a time, at full rate
_GRADIENT_MARGIN = 16  # samples that numerical derivatives need on both sides


@dataclass(frozen=True)
class Data:
    """Motions prepared for fitting.

    Attributes:
        motions: Decimated motions, see :func:`decimated_motion`.
        folds: Cross-validation fold of every sample, shape (N,) for each motion.
        cutoff: Cut-off of the filter of columns and torque, [Hz].
        standing: Speed of each joint below which it stands, shape (n,), [rad/s].
        band: Bandwidth of the logged torque, [Hz], if its logger has filtered it below
            the cut-off. Columns pass that filter, too, and torque no other one.

    Raises:
        RecordingError: A motion has no torque.
    """

    motions: tuple[Motion, ...]
    folds: tuple[Index, ...]
    cutoff: float
    standing: Array
    band: float = np.inf

    def __post_init__(self) -> None:
        check_torque(self.motions)

    def minus(self, known: Sequence[Array] | None) -> Data:
        """The same data less a known torque, shape (N, n) for each motion, [N·m]."""
        if known is None:
            return self
        pairs = zip(self.motions, known, strict=True)
        return replace(self, motions=tuple(replace(m, tau=m.tau - x) for m, x in pairs))

    def rows(
        self, problem: Problem, motion: Motion, end: int | None = None
    ) -> Iterator[tuple[int, Array, Array]]:
        """Rows of a problem along a motion, some samples at a time.

        Columns and torque are filtered identically. Torque that its logger has filtered
        passes no other filter, and columns that one even at full rate. Chunks overlap
        by the length of the filter, so the result does not depend on them. Those that
        begin at the sample ``end`` or later are left out.

        Yields:
            Index of the first sample, the rows filtered and decimated, (P, M), and at
            full rate, (P, N).
        """
        sampler, total = self.sampler(motion.rate), len(motion.t)
        factor = sampler.factor
        margin = -(-max(sampler.margin, _GRADIENT_MARGIN) // factor) * factor
        chunk = max(_CHUNK, 4 * margin) // factor * factor
        for start in range(0, total if end is None else end, chunk):
            before, stop = max(0, start - margin), min(total, start + chunk)
            full = problem.rows(part(motion, slice(before, stop + margin)))
            if self.band < np.inf:
                columns = np.delete(np.arange(len(full)), problem.torque_rows)
                full[columns] = self.seen(motion, full[columns].T).T
                D = full[:, ::factor]
            else:
                D = sampler(full, axis=1)
            skipped, count = (start - before) // factor, -(-(stop - start) // factor)
            inner = slice(start - before, stop - before)
            yield start, D[:, skipped : skipped + count], full[:, inner]

    def held_out_residual(self, problem: Problem, theta: Array) -> list[Array]:
        """Unfiltered residual of each sample by the solution without its fold.

        Solutions have shape (F, p), and residuals (N, n) for each motion, [N·m].
        """
        found = []
        for fold, motion in zip(self.folds, self.motions, strict=True):
            residual = np.empty((len(fold), len(problem.support)))
            for start, _, full in self.rows(problem, motion):
                here = slice(start, start + full.shape[1])
                parts = np.split(full, problem.offsets[1:-1])
                for i, own in enumerate(parts):
                    known = theta[:, problem.support[i]] @ own[:-1]
                    known = np.take_along_axis(known, fold[None, here], axis=0)[0]
                    residual[here, i] = own[-1] - known
            found.append(residual)
        return found

    def squares(self, residual: Sequence[Array]) -> Array:
        """Squares of the moving joints in each block, shape (B, n), [N²·m²].

        The residual is at the rate of the motions, shape (N, n) for each, [N·m].
        """
        label = np.concatenate(self.blocks)
        moves = np.concatenate([self.moves(m) for m in self.motions])
        squares = np.where(moves, np.concatenate(residual), 0.0) ** 2
        return np.stack([np.bincount(label, x) for x in squares.T], axis=1)

    @cached_property
    def blocks(self) -> list[Index]:
        """Block of each sample, shape (N,) for each motion; each lies in one fold."""
        each = max(1, -(-_FEWEST_BLOCKS // len(self.motions)))
        found, last = [], 0
        for fold in self.folds:
            position = np.arange(len(fold)) * each // len(fold)
            _, label = np.unique(position * self.fold_count + fold, return_inverse=True)
            found.append(last + label)
            last += 1 + int(label.max())
        return found

    @cached_property
    def block_folds(self) -> Index:
        """Fold of each block, shape (B,)."""
        _, first = np.unique(np.concatenate(self.blocks), return_index=True)
        return np.concatenate(self.folds)[first]

    def sampler(self, rate: float) -> Sampler:
        """Filter and decimator of columns at a rate, [Hz]."""
        return Sampler.for_rate(rate, min(self.cutoff, self.band))

    def logged(self, motion: Motion) -> Array:
        """Decimated torque, which has passed no more than the filter of columns."""
        sampler = self.sampler(motion.rate)
        return sampler.keep(motion.tau) if self.band < np.inf else sampler(motion.tau)

    def seen(self, motion: Motion, torque: Array) -> Array:
        """Modelled torque along a motion as its logger shows it, shape (N, ...)."""
        if self.band == np.inf:
            return torque
        return Sampler(motion.rate, self.band, 1)(torque)

    @cached_property
    def fold_count(self) -> int:
        """Number of folds F."""
        return 1 + max(int(fold.max()) for fold in self.folds)

    @cached_property
    def scales(self) -> list[Scale]:
        """Highest torque and speed of every joint; at rest, the speed of standing."""
        each = [np.abs(m.tau[m.mask]).max(axis=0) for m in self.motions]
        speed = np.maximum(self.visited["v_max"], self.standing)
        highest = np.maximum([np.max(each, axis=0), speed], 1e-12)
        return [Scale(*x) for x in highest.T.tolist()]

    @cached_property
    def visited(self) -> dict[str, Array]:
        """Lowest and highest position and highest speed, each of shape (n,)."""
        return visited(self.motions)

    @cached_property
    def resting(self) -> Mask:
        """Whether each joint stands all the time, shape (n,)."""
        return self.visited["v_max"] <= self.standing

    @cached_property
    def moving(self) -> Array:
        """Number of samples at which each joint moves, at least 1, shape (n,)."""
        each = [self.moves(m).sum(axis=0) for m in self.motions]
        return np.asarray(np.maximum(np.sum(each, axis=0), 1.0))

    def moves(self, motion: Motion) -> Mask:
        """Samples that are not masked and at which each joint moves, shape (N, n)."""
        moves = np.abs(motion.v) > self.standing
        return np.asarray(moves & motion.mask[:, None])


def check_torque(motions: Sequence[Motion]) -> None:
    """Refuse motions without torque.

    Raises:
        RecordingError: One has none.
    """
    for motion in motions:
        if not np.isfinite(motion.tau).all():
            raise RecordingError(
                f"{motion.source or 'recording'}: no torque; valid is a log of time, "
                "positions and torques; fit_servo takes one of positions and commands"
            )


def visited(motions: Sequence[Motion]) -> dict[str, Array]:
    """Lowest and highest position and highest speed, each of shape (n,)."""
    q = [m.q[m.mask] for m in motions]
    return {
        "q_min": np.min([x.min(axis=0) for x in q], axis=0),
        "q_max": np.max([x.max(axis=0) for x in q], axis=0),
        "v_max": fastest(motions),
    }


def fastest(motions: Sequence[Motion]) -> Array:
    """Highest speed of each joint, shape (n,)."""
    each = [np.abs(m.v[m.mask]).max(axis=0) for m in motions]
    return np.asarray(np.max(each, axis=0))
