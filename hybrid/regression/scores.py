"""Held-out squared residuals of the unfiltered torque, from sums over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.regression.problem import Problem


@dataclass(frozen=True)
class Scores:
    """Sums of products of unfiltered rows.

    Attributes:
        problem: Unknowns and layout of the rows.
        sums: Rows of a joint times rows transposed, summed over each block, shape
            (B, d + 1, d + 1) for each joint.
        fold: Fold of each block, shape (B,).
    """

    problem: Problem
    sums: tuple[Array, ...]
    fold: NDArray[np.intp]

    def squares(self, theta: Array) -> Array:
        """Squared residuals in each block of the solution without its fold.

        Args:
            theta: Solutions without each fold, shape (F, p).

        Returns:
            Squares of each joint, shape (B, n), [N²·m²].
        """
        own = theta[self.fold]  # (B, p)
        found = np.empty((len(own), len(self.sums)))
        for i, (sums, support) in enumerate(
            zip(self.sums, self.problem.support, strict=True)
        ):
            c = np.concatenate([-own[:, support], np.ones((len(own), 1))], axis=1)
            found[:, i] = np.einsum("bk,bkl,bl->b", c, sums, c)
        return np.maximum(found, 0.0)


class Scoring:
    """Accumulates :class:`Scores` chunk by chunk."""

    def __init__(
        self,
        problem: Problem,
        blocks: Sequence[NDArray[np.intp]],
        folds: Sequence[NDArray[np.intp]],
    ) -> None:
        self.blocks = blocks
        label, first = np.unique(np.concatenate(blocks), return_index=True)
        count, sizes = 1 + int(label.max()), np.diff(problem.offsets)
        fold = np.zeros(count, dtype=np.intp)
        fold[label] = np.concatenate(folds)[first]
        sums = tuple(np.zeros((count, size, size)) for size in sizes)
        self.scores = Scores(problem, sums, fold)

    def add(self, r: int, here: slice, D: Array, moving: Array) -> None:
        """Add rows of some samples of motion r.

        Args:
            r: Index of the motion.
            here: The samples.
            D: Their rows, shape (P, N); set to zero in place where the joint stands.
            moving: One where a joint moves, else zero, shape (n, N).
        """
        label = self.blocks[r][here]
        runs, offsets = runs_of(label), self.scores.problem.offsets
        for i, sums in enumerate(self.scores.sums):
            own = D[offsets[i] : offsets[i + 1]]
            own *= moving[i]
            for start, stop in runs:
                part = own[:, start:stop]
                sums[label[start]] += part @ part.T


def runs_of(*labels: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of equal labels."""
    steps = np.sum([np.abs(np.diff(x, prepend=-1)) for x in labels], axis=0)
    return list(pairwise([*np.flatnonzero(steps), len(labels[0])]))
