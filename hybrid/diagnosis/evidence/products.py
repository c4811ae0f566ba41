"""Cross-products of the gap with every column that might explain it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.noise import Noise
from hybrid.diagnosis.gap.gap import Columns, Gap

Index = NDArray[np.intp]

_ROOM = 1.5  # times as much as is needed, so that little is copied


class Products:
    """The gap, and columns that might explain it, multiplied with each other once.

    Columns are kept joint by joint: most effects reach one joint only. Nothing here
    depends on the number of samples once the noise is known and a column is in.

    Args:
        gap: The gap.
        use: Samples that count, shape (M,); all by default.

    Attributes:
        rows: Samples of each joint, fold by fold.
        folds: Numbers of the folds, shape (F,).
        left: The gap at each joint's rows, [N·m].
        count: Number of samples, shape (n, F).
        noise: Variance of independent samples of noise of each joint, shape (n,),
            [N²·m²].
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
        self.count = np.array([np.diff(e) for e in self._edges])  # (n, F)
        self.noise = np.ones(n)
        self.size = 0
        self._processes: list[Noise] | None = None
        self._white = list(self.left)  # as independent samples
        self._owner: list[list[int]] = [[] for _ in range(n)]
        # One a row, with room for more.
        self._columns = [np.zeros((0, len(r))) for r in self.rows]
        self._sums = [(np.zeros((0, 0)), np.zeros(0)) for _ in range(n)]
        self._done = [0] * n  # columns that are in the sums
        self._kept: tuple[bytes, dict[int, tuple[Index, Array]]] = b"", {}

    @property
    def power(self) -> Array:
        """Sum of squares of the gap, shape (n, F), [N²·m²]."""
        return self._by_fold(x**2 for x in self.left)

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
                self._extend(i, self._whiten(i, np.hstack(parts)).T, names[i])
        return index

    def weigh(self, covariances: Sequence[Array]) -> None:
        """Let noise be processes from now on.

        Args:
            covariances: Of each joint, at lags from zero on, shape (p + 1,), [N²·m²].
        """
        gap, processes = self.gap, []
        for rows, covariance in zip(self.rows, covariances, strict=True):
            follows = np.diff(rows, prepend=-2) == 1
            for part in (gap.fold, gap.trajectory):
                follows &= np.diff(part[rows], prepend=-1) == 0
            processes.append(Noise(covariance, follows))
        # Joint by joint: two copies of all columns are too many.
        for i, (names, process) in enumerate(zip(self._owner, processes, strict=True)):
            columns = self._columns[i][: len(names)]
            columns[:] = process.whiten(self._coloured(i, columns.T)).T
            self._white[i], self._done[i] = process.whiten(self.left[i]), 0
        self._processes, self._kept = processes, (b"", {})

    def _whiten(self, i: int, x: Array) -> Array:
        return x if self._processes is None else self._processes[i].whiten(x)

    def _weight(self, i: int) -> float:
        """What a product of whitened samples counts."""
        return 1.0 if self._processes is not None else float(1.0 / self.noise[i])

    def _extend(self, i: int, new: Array, names: list[int]) -> None:
        k, whole = len(self._owner[i]), len(self._owner[i]) + len(new)
        if whole > len(self._columns[i]):
            shape = round(_ROOM * whole), new.shape[1]
            self._columns[i] = _roomier(self._columns[i], k, shape)
        self._columns[i][k:whole] = new
        self._owner[i] += names

    def _multiplied(self, i: int) -> tuple[Array, Array]:
        """Products of all columns of a joint, and with the gap."""
        whole, columns = len(self._owner[i]), self._columns[i]
        (gram, moment), k = self._sums[i], self._done[i]
        if whole > k:
            if whole > len(moment):
                size = round(_ROOM * whole)
                gram, moment = _roomier(gram, k, (size, size)), np.resize(moment, size)
            new = columns[k:whole]
            gram[:k, k:whole] = columns[:k] @ new.T
            gram[k:whole, :k] = gram[:k, k:whole].T
            gram[k:whole, k:whole] = new @ new.T  # of half the cost: it is symmetric
            moment[k:whole] = new @ self._white[i]
            self._sums[i], self._done[i] = (gram, moment), whole
        return gram, moment

    def _here(self, i: int, index: Index) -> tuple[Index, Index]:
        """Which columns of a joint are among some, and which of these they are."""
        where = np.full(self.size, -1)
        where[index] = np.arange(len(index))
        target = where[self._owner[i]]
        here = np.flatnonzero(target >= 0)
        return here, target[here]

    def normal(self, index: Index) -> tuple[Array, Array]:
        """Normal matrix (k, k) and vector (k,) of some columns, weighed by noise."""
        A, b = np.zeros((len(index), len(index))), np.zeros(len(index))
        for i in range(len(self.rows)):
            if self._processes is None:  # it is asked once or twice only
                at, columns = self.known(index, i)
                gram, moment = columns @ columns.T, columns @ self._white[i]
            else:
                here, at = self._here(i, index)
                gram, moment = self._multiplied(i)
                gram, moment = gram[np.ix_(here, here)], moment[here]
            A[np.ix_(at, at)] += gram * self._weight(i)
            b[at] += moment * self._weight(i)
        return A, b

    def normal_by_fold(self, index: Index) -> tuple[Array, Array]:
        """The same of each fold, shapes (F, k, k) and (F, k)."""
        F, k = len(self.folds), len(index)
        A, b = np.zeros((F, k, k)), np.zeros((F, k))
        for i in range(len(self.rows)):
            (at, columns), weight = self.known(index, i), self._weight(i)
            for f, (first, last) in enumerate(self.parts(i)):
                own, left = columns[:, first:last], self._white[i][first:last]
                A[f][np.ix_(at, at)] += own @ own.T * weight
                b[f][at] += own @ left * weight
        return A, b

    def parts(self, i: int) -> list[tuple[int, int]]:
        """First and last of a joint's samples in each fold."""
        edges = self._edges[i].tolist()
        return list(zip(edges[:-1], edges[1:], strict=True))

    def beside(
        self, base: Index, wanted: Index, places: Mapping[int, Index]
    ) -> tuple[Array, dict[int, Array], Array]:
        """Cross-products of columns, weighed by noise.

        Args:
            base: Some columns, shape (k,).
            wanted: Others, shape (K,).
            places: Which of the others make up blocks of one size p, shape (B, p) each.

        Returns:
            Those of the two, shape (k, K); those within the blocks of a size, shape
            (B, p, p); and with the gap, shape (K,).
        """
        across, moment = np.zeros((len(base), len(wanted))), np.zeros(len(wanted))
        within = {p: np.zeros((*x.shape, p)) for p, x in places.items()}
        for i in range(len(self.rows)):
            gram, beside, weight = *self._multiplied(i), self._weight(i)
            (here, k), (there, m) = self._here(i, base), self._here(i, wanted)
            across[np.ix_(k, m)] += gram[np.ix_(here, there)] * weight
            moment[m] += beside[there] * weight
            mine = np.full(len(wanted), -1)
            mine[m] = there
            for p, x in places.items():
                use = mine[x[:, 0]] >= 0  # a block is all of a joint, or not at all
                at = mine[x[use]]
                within[p][use] += gram[at[:, :, None], at[:, None, :]] * weight
        return across, within, moment

    def known(self, base: Index, i: int) -> tuple[Index, Array]:
        """Columns of a joint that are in a base, one a row, with their place; kept."""
        if self._kept[0] != base.tobytes():
            self._kept = base.tobytes(), {}
        if i not in self._kept[1]:
            self._kept[1][i] = self._here(i, base)[1], self.own(i, base)
        return self._kept[1][i]

    def own(self, i: int, index: Index) -> Array:
        """Columns of a joint that are among some, as independent samples, one a row."""
        return self._columns[i][self._here(i, index)[0]]

    def cross(self, base: Index, i: int, x: Array) -> tuple[Index, Array, Array, Array]:
        """Cross-products of columns that are not in, weighed by noise.

        Args:
            base: Columns that are in, shape (k,).
            i: Joint.
            x: Its columns, shape (R, p).

        Returns:
            Which of the base reach the joint, and products with these, of the columns
            with each other and with the gap.
        """
        new, (target, known) = self._whiten(i, x), self.known(base, i)
        parts = (known @ new, new.T @ new, new.T @ self._white[i])
        across, own, moment = (self._weight(i) * part for part in parts)
        return target, across, own, moment

    def squares(self, index: Index, gains: Array) -> Array:
        """Sum of squares left on each joint and fold, shape (n, F), [N²·m²].

        Args:
            index: Columns.
            gains: Their gains, shape (k,).
        """
        joints = range(len(self.rows))
        return self._by_fold(self.residual(i, index, gains) ** 2 for i in joints)

    def _by_fold(self, x: Iterable[Array]) -> Array:
        """Sums of each joint's samples, shape (n, F)."""
        sums = ([x[a:b].sum() for a, b in self.parts(i)] for i, x in enumerate(x))
        return np.array(list(sums))

    def _fitted(
        self, i: int, index: Index, gains: Array, part: slice = slice(None)
    ) -> Array:
        """What gains make at a joint, whitened."""
        at, columns = self.known(index, i)
        return np.asarray(gains[at] @ columns[:, part])

    def _coloured(self, i: int, x: Array) -> Array:
        return x if self._processes is None else self._processes[i].colour(x)

    def lost(self, index: Index, gains: Array) -> Array:
        """Squares that gains leave at each joint, weighed by noise, shape (n,)."""
        out = np.zeros(len(self.rows))
        for i, white in enumerate(self._white):
            left = white - self._fitted(i, index, gains)
            out[i] = self._weight(i) * (left @ left)
        return out

    def made(self, index: Index, gains: Array) -> Array:
        """Squares of what gains make at each joint, weighed by noise, shape (n,)."""
        out = np.zeros(len(self.rows))
        for i in range(len(self.rows)):
            torque = self._fitted(i, index, gains)
            out[i] = self._weight(i) * (torque @ torque)
        return out

    def residual(self, i: int, index: Index, gains: Array) -> Array:
        """What gains leave of the gap at a joint, in the order of ``rows[i]``."""
        return self._coloured(i, self._white[i] - self._fitted(i, index, gains))


def _roomier(x: Array, used: int, shape: tuple[int, int]) -> Array:
    """The same rows, and as many columns, with room for more."""
    out = np.empty(shape)
    out[:used, : x.shape[1]] = x[:used]
    return out
