"""Held-out squared residuals of the unfiltered torque, from sums over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.regression.problem import Problem


class Scores:
    """Sums of products of the unfiltered rows of each joint, over scoring blocks.

    Args:
        problem: Unknowns and layout of the rows.
        blocks: Block of every sample, in one fold each, shape (N,) for each motion.
        folds: Fold of every sample, shape (N,) for each motion.
    """

    def __init__(
        self,
        problem: Problem,
        blocks: Sequence[NDArray[np.intp]],
        folds: Sequence[NDArray[np.intp]],
    ) -> None:
        self._problem, self._blocks = problem, blocks
        label, first = np.unique(np.concatenate(blocks), return_index=True)
        count, sizes = 1 + int(label.max()), np.diff(problem.offsets)
        self._fold = np.zeros(count, dtype=np.intp)
        self._fold[label] = np.concatenate(folds)[first]
        self._sums = [np.zeros((count, size, size)) for size in sizes]

    def add(self, r: int, here: slice, D: Array, moving: Array) -> None:
        """Add rows of some samples of motion r.

        Args:
            r: Index of the motion.
            here: The samples.
            D: Their rows, shape (P, N); set to zero in place where the joint stands.
            moving: One where a joint moves, else zero, shape (n, N).
        """
        label = self._blocks[r][here]
        runs, offsets = runs_of(label), self._problem.offsets
        for i, sums in enumerate(self._sums):
            own = D[offsets[i] : offsets[i + 1]]
            own *= moving[i]
            for start, stop in runs:
                part = own[:, start:stop]
                sums[label[start]] += part @ part.T

    def squares(self, theta: Array) -> Array:
        """Squared residuals of each block by the solution without its fold, (B, n).

        Args:
            theta: Solutions without each fold, shape (F, p).
        """
        own = theta[self._fold]  # (B, p)
        found = np.empty((len(own), len(self._sums)))
        pairs = zip(self._sums, self._problem.support, strict=True)
        for i, (sums, support) in enumerate(pairs):
            c = np.concatenate([-own[:, support], np.ones((len(own), 1))], axis=1)
            found[:, i] = np.einsum("bk,bkl,bl->b", c, sums, c)
        return np.maximum(found, 0.0)


def runs_of(*labels: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of equal labels."""
    steps = np.sum([np.abs(np.diff(x, prepend=-1)) for x in labels], axis=0)
    return list(pairwise([*np.flatnonzero(steps), len(labels[0])]))
