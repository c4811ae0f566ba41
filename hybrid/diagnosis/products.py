"""Cross-products of the gap with every column that might explain it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.gap import Columns, Gap

Index = NDArray[np.intp]

_TAIL = 0.01  # of the squares of a column
_ROOM = 64  # columns


class Products:
    """The gap, and columns that might explain it, multiplied with each other once.

    Columns are kept joint by joint: most effects reach one joint only. Nothing here
    depends on the number of samples once a column is in.

    Args:
        gap: The gap.
        use: Samples that count, shape (M,); all by default.

    Attributes:
        rows: Samples of each joint, fold by fold.
        folds: Numbers of the folds, shape (F,).
        left: The gap at each joint's rows, [N·m].
        power: Its sum of squares, shape (n, F), [N²·m²].
        count: Number of samples, shape (n, F).
        noise: Variance by which a joint's products are weighed, shape (n,), [N²·m²].
        size: Number of columns K.
    """

    def __init__(self, gap: Gap, use: NDArray[np.bool_] | None = None) -> None:
        self.gap = gap
        n = gap.robot.size
        moving = gap.moving if use is None else gap.moving & use[:, None]
        rows = [np.flatnonzero(moving[:, i]) for i in range(n)]
        # Sorted by fold, so that a fold is a slice; stable, so that time runs on.
        self.rows = [r[np.argsort(gap.fold[r], kind="stable")] for r in rows]
        self.folds = np.unique(gap.fold if use is None else gap.fold[use])
        self._edges = [
            np.searchsorted(gap.fold[r], [*self.folds, self.folds[-1] + 1])
            for r in self.rows
        ]
        self.left = [gap.left[r, i] for i, r in enumerate(self.rows)]
        self.power = np.array(
            [
                [x[a:b] @ x[a:b] for a, b in zip(e[:-1], e[1:], strict=True)]
                for x, e in zip(self.left, self._edges, strict=True)
            ]
        )  # (n, F)
        self.count = np.array([np.diff(e) for e in self._edges])  # (n, F)
        self.noise = np.ones(n)
        self.size = 0
        F = len(self.folds)
        self._owner: list[list[int]] = [[] for _ in range(n)]
        # With room for more: what is taken in one by one is not copied each time.
        self._columns = [np.zeros((len(r), 0)) for r in self.rows]
        self._gram = [np.zeros((F, 0, 0)) for _ in range(n)]
        self._moment = [np.zeros((F, 0)) for _ in range(n)]
        self._sums = [(np.zeros((0, 0)), np.zeros(0)) for _ in range(n)]
        self._kept: tuple[bytes, dict[int, tuple[Index, Array]]] = b"", {}

    def take(self, blocks: Sequence[Columns], sizes: Sequence[int]) -> list[Index]:
        """Take in columns.

        Args:
            blocks: Columns by joint, shape (M, p) each.
            sizes: Number of columns p of each block.

        Returns:
            Index of the columns of each block.
        """
        index = []
        fresh: list[list[Array]] = [[] for _ in self.rows]
        names: list[list[int]] = [[] for _ in self.rows]
        for columns, count in zip(blocks, sizes, strict=True):
            own = np.arange(self.size, self.size + count)
            for i, x in columns.items():
                fresh[i].append(x[self.rows[i]])
                names[i] += own.tolist()
            index.append(own)
            self.size += count
        for i, parts in enumerate(fresh):
            if parts:
                self._extend(i, np.concatenate(parts, axis=1), names[i])
        return index

    def _extend(self, i: int, new: Array, names: list[int]) -> None:
        k, whole = len(self._owner[i]), len(self._owner[i]) + new.shape[1]
        self._make_room(i, whole)
        columns, gram, moment = self._columns[i], self._gram[i], self._moment[i]
        columns[:, k:whole] = new
        for f, (a, b) in enumerate(
            zip(self._edges[i][:-1], self._edges[i][1:], strict=True)
        ):
            cross = columns[a:b, :whole].T @ new[a:b]
            gram[f, :whole, k:whole], gram[f, k:whole, :whole] = cross, cross.T
            moment[f, k:whole] = new[a:b].T @ self.left[i][a:b]
        self._owner[i] += names
        total, sums = np.zeros((whole, whole)), self._sums[i]
        total[:k, :k] = sums[0]
        total[:, k:] = gram[:, :whole, k:whole].sum(axis=0)
        total[k:, :k] = total[:k, k:].T
        own = moment[:, k:whole].sum(axis=0)
        self._sums[i] = total, np.concatenate([sums[1], own])

    def _make_room(self, i: int, wanted: int) -> None:
        if wanted <= self._columns[i].shape[1]:
            return
        k, room = len(self._owner[i]), wanted + _ROOM
        F = len(self.folds)
        columns, gram = np.empty((len(self.rows[i]), room)), np.empty((F, room, room))
        moment = np.empty((F, room))
        columns[:, :k] = self._columns[i][:, :k]
        gram[:, :k, :k] = self._gram[i][:, :k, :k]
        moment[:, :k] = self._moment[i][:, :k]
        self._columns[i], self._gram[i], self._moment[i] = columns, gram, moment

    def normal(self, index: Index, folds: Index | None = None) -> tuple[Array, Array]:
        """Normal matrix (k, k) and vector (k,) of some columns, weighed by noise.

        Args:
            index: Columns.
            folds: Which folds count; all by default.
        """
        A, b = np.zeros((len(index), len(index))), np.zeros(len(index))
        where = np.full(self.size, -1)
        where[index] = np.arange(len(index))
        for i, owner in enumerate(self._owner):
            target = where[owner]
            here = np.flatnonzero(target >= 0)
            at = target[here]
            gram, moment = (x[here] for x in self._sums[i])
            gram = gram[:, here]
            if folds is not None:
                gram = self._gram[i][np.ix_(folds, here, here)].sum(axis=0)
                moment = self._moment[i][np.ix_(folds, here)].sum(axis=0)
            A[np.ix_(at, at)] += gram / self.noise[i]
            b[at] += moment / self.noise[i]
        return A, b

    def beside(
        self, base: Index, wanted: Index, first: Index, second: Index
    ) -> tuple[Array, Array, Array]:
        """Cross-products of columns, weighed by noise.

        Args:
            base: Some columns, shape (k,).
            wanted: Others, shape (K,).
            first: Which of the others to multiply, shape (P,).
            second: And with which, shape (P,).

        Returns:
            Those of the two, shape (k, K); those among the others, shape (P,); and
            with the gap, shape (K,).
        """
        across = np.zeros((len(base), len(wanted)))
        own, moment = np.zeros(len(first)), np.zeros(len(wanted))
        for i, owner in enumerate(self._owner):
            place = np.full(self.size, -1)
            place[owner] = np.arange(len(owner))
            (gram, beside), k, m = self._sums[i], place[base], place[wanted]
            here, there = np.flatnonzero(k >= 0), np.flatnonzero(m >= 0)
            block = gram[np.ix_(k[here], m[there])]
            across[np.ix_(here, there)] += block / self.noise[i]
            both = np.flatnonzero((m[first] >= 0) & (m[second] >= 0))
            own[both] += gram[m[first[both]], m[second[both]]] / self.noise[i]
            moment[there] += beside[m[there]] / self.noise[i]
        return across, own, moment

    def known(self, base: Index, i: int) -> tuple[Index, Array]:
        """Columns of a joint that are in a base, with their place in it; kept."""
        if self._kept[0] != base.tobytes():
            self._kept = base.tobytes(), {}
        if i not in self._kept[1]:
            where = np.full(self.size, -1)
            where[base] = np.arange(len(base))
            target = where[self._owner[i]]
            here = np.flatnonzero(target >= 0)
            self._kept[1][i] = target[here], self._columns[i][:, here]
        return self._kept[1][i]

    def folds_with(self, index: Index) -> int:
        """Number of folds in which some columns are more than the tail of a filter."""
        power = np.zeros(len(self.folds))
        for gram, owner in zip(self._gram, self._owner, strict=True):
            here = np.flatnonzero(np.isin(owner, index))
            power += gram[:, here, here].sum(axis=1)
        return int(np.count_nonzero(power > _TAIL * power.max()))

    def squares(self, index: Index, gains: Array) -> Array:
        """Sum of squares left on each joint and fold, shape (n, F), [N²·m²].

        Args:
            index: Columns.
            gains: Their gains, shape (k,); or on each fold its own, shape (F, k).
        """
        gains = np.broadcast_to(gains, (len(self.folds), len(index)))
        out = self.power.copy()
        where = np.full(self.size, -1)
        where[index] = np.arange(len(index))
        for i, owner in enumerate(self._owner):
            target = where[owner]
            here = np.flatnonzero(target >= 0)
            g = gains[:, target[here]]
            gram = self._gram[i][:, here[:, None], here]
            out[i] += np.einsum("fk,fkl,fl->f", g, gram, g)
            out[i] -= 2 * np.einsum("fk,fk->f", g, self._moment[i][:, here])
        return np.asarray(out)

    def made(self, index: Index, gains: Array) -> Array:
        """Squares of what gains make at each joint, weighed by noise, shape (n,)."""
        out, order = np.zeros(len(self.rows)), np.argsort(index)
        for i, owner in enumerate(self._owner):
            here = np.flatnonzero(np.isin(owner, index))
            own = np.asarray(owner)[here]
            g = gains[order[np.searchsorted(index[order], own)]]
            out[i] = g @ self._sums[i][0][np.ix_(here, here)] @ g / self.noise[i]
        return out

    def residual(self, i: int, index: Index, gains: Array) -> Array:
        """What gains leave of the gap at a joint, in the order of ``rows[i]``."""
        full = np.zeros(self.size)
        full[index] = gains
        owner = self._owner[i]
        fitted = self._columns[i][:, : len(owner)] @ full[owner]
        return np.asarray(self.left[i] - fitted)
