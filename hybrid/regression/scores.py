"""Held-out squared residuals of the unfiltered torque, from sums over blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array


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
        """Sums of nothing, of joints with rows of these ``sizes``."""
        label, first = np.unique(np.concatenate(blocks), return_index=True)
        count = 1 + int(label.max())
        fold = np.zeros(count, dtype=np.intp)
        fold[label] = np.concatenate(folds)[first]
        return cls(tuple(np.zeros((count, d, d)) for d in sizes), fold)

    def add(self, block: NDArray[np.intp], D: Array, moving: NDArray[np.bool_]) -> None:
        """Add rows D (P, N) of samples with these blocks, where joints are moving."""
        own = np.split(D, np.cumsum([x.shape[1] for x in self.sums])[:-1])
        for sums, rows, moves in zip(self.sums, own, moving, strict=True):
            for start, stop in runs_of(block, moves.astype(int)):
                if moves[start]:
                    part = rows[:, start:stop]
                    sums[block[start]] += part @ part.T

    def squares(self, theta: Array, support: Sequence[NDArray[np.intp]]) -> Array:
        """Squares of each block (B, n) by the solutions without each fold (F, p).

        Rows of a joint but the last, its torque, belong to the unknowns ``support``.
        """
        own = theta[self.fold]  # (B, p)
        found = np.empty((len(own), len(self.sums)))
        for i, (sums, used) in enumerate(zip(self.sums, support, strict=True)):
            c = np.concatenate([-own[:, used], np.ones((len(own), 1))], axis=1)
            found[:, i] = np.einsum("bk,bkl,bl->b", c, sums, c)
        return np.maximum(found, 0.0)


def runs_of(*labels: NDArray[np.intp]) -> list[tuple[int, int]]:
    """Start and end (exclusive) of each run of equal labels."""
    steps = np.sum([np.abs(np.diff(x, prepend=-1)) for x in labels], axis=0)
    return list(pairwise([*np.flatnonzero(steps), len(labels[0])]))
