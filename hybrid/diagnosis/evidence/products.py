"""Cross-products of the gap and the columns that might explain it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.noise import Noise
from hybrid.diagnosis.gap.gap import Columns, Gap

Index = NDArray[np.intp]

_ROOM = 1.5  # allocated over needed memory, so that little is copied


class Products:
    """Whitened gap and columns of each joint, with their cross-products.

    Columns are stored joint by joint, as most effects reach one joint only. Each
    cross-product is computed once.

    Args:
        use: Samples that are used, shape (M,); all by default.

    Attributes:
        rows: Samples of each joint, sorted by fold.
        folds: Numbers of the folds, shape (F,).
        left: The gap at each joint's rows, [N·m].
        count: Number of samples of each joint, shape (n,).
        noise: Variance of each joint's noise for samples that count as independent,
            shape (n,), [N²·m²].
        size: Number of columns K.
    """

    def __init__(self, gap: Gap, use: NDArray[np.bool_] | None = None) -> None:
        self.gap = gap
        n = gap.robot.size
        moving = gap.moving if use is None else gap.moving & use[:, None]
        rows = [np.flatnonzero(moving[:, i]) for i in range(n)]
        # A fold is a slice; the sort is stable, so that samples stay in time order.
        self.rows = [r[np.argsort(gap.fold[r], kind="stable")] for r in rows]
        self.folds = np.unique(gap.fold if use is None else gap.fold[use])
        self._edges = [
            np.searchsorted(gap.fold[r], [*self.folds, self.folds[-1] + 1])
            for r in self.rows
        ]
        self.left = [gap.left[r, i] for i, r in enumerate(self.rows)]
        self.count = np.array([len(r) for r in self.rows])
        self.noise = np.ones(n)
        self.size = 0
        self._processes: list[Noise] | None = None
        self._white = list(self.left)  # the gap, whitened
        self._owner: list[list[int]] = [[] for _ in range(n)]  # number of each column
        self._columns = [np.zeros((0, len(r))) for r in self.rows]  # one a row
        self._sums = [(np.zeros((0, 0)), np.zeros(0)) for _ in range(n)]
        self._done = [0] * n  # number of columns in the sums
        self._base: tuple[bytes, dict[int, tuple[Index, Array]]] = b"", {}

    @property
    def power(self) -> Array:
        """Sum of squares of the gap at each joint, shape (n,), [N²·m²]."""
        return np.array([x @ x for x in self.left])

    def add_columns(
        self, blocks: Sequence[Columns], sizes: Sequence[int]
    ) -> list[Index]:
        """Add blocks of columns of some sizes; see :meth:`.Evidence.add`."""
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

    def set_covariances(self, covariances: Sequence[Array]) -> None:
        """Whiten the gap and all columns by noise processes.

        Args:
            covariances: Covariance of each joint's noise at lags from zero on, shape
                (p + 1,), [N²·m²].
        """
        gap, processes = self.gap, []
        for rows, covariance in zip(self.rows, covariances, strict=True):
            follows = np.diff(rows, prepend=-2) == 1
            for part in (gap.fold, gap.trajectory):
                follows &= np.diff(part[rows], prepend=-1) == 0
            processes.append(Noise(covariance, follows))
        # Joint by joint, as two copies of all columns need too much memory.
        for i, (names, process) in enumerate(zip(self._owner, processes, strict=True)):
            columns = self._columns[i][: len(names)]
            columns[:] = process.whiten(self._colour(i, columns.T)).T
            self._white[i], self._done[i] = process.whiten(self.left[i]), 0
        self._processes, self._base = processes, (b"", {})

    def _whiten(self, i: int, x: Array) -> Array:
        return x if self._processes is None else self._processes[i].whiten(x)

    def _colour(self, i: int, x: Array) -> Array:
        return x if self._processes is None else self._processes[i].colour(x)

    def _weight(self, i: int) -> float:
        """Weight of a product: inverse noise variance before samples are whitened."""
        return 1.0 if self._processes is not None else float(1.0 / self.noise[i])

    def _extend(self, i: int, new: Array, names: list[int]) -> None:
        k, whole = len(self._owner[i]), len(self._owner[i]) + len(new)
        if whole > len(self._columns[i]):
            shape = round(_ROOM * whole), new.shape[1]
            self._columns[i] = _enlarged(self._columns[i], k, shape)
        self._columns[i][k:whole] = new
        self._owner[i] += names

    def _multiplied(self, i: int) -> tuple[Array, Array]:
        """Cross-products of all columns of a joint, and with the gap."""
        whole, columns = len(self._owner[i]), self._columns[i]
        (gram, moment), k = self._sums[i], self._done[i]
        if whole > k:
            if whole > len(moment):
                size = round(_ROOM * whole)
                gram, moment = _enlarged(gram, k, (size, size)), np.resize(moment, size)
            new = columns[k:whole]
            gram[:k, k:whole] = columns[:k] @ new.T
            gram[k:whole, :k] = gram[:k, k:whole].T
            gram[k:whole, k:whole] = new @ new.T
            moment[k:whole] = new @ self._white[i]
            self._sums[i], self._done[i] = (gram, moment), whole
        return gram, moment

    def _here(self, i: int, index: Index) -> tuple[Index, Index]:
        """Rows of a joint that hold columns of an index, and positions in the index."""
        where = np.full(self.size, -1)
        where[index] = np.arange(len(index))
        target = where[self._owner[i]]
        here = np.flatnonzero(target >= 0)
        return here, target[here]

    def normal(self, index: Index) -> tuple[Array, Array]:
        """Weighted normal matrix (k, k) and right-hand side (k,) of some columns."""
        if self._processes is None:  # too seldom to store all products
            A, b = self.normal_by_fold(index)
            return A.sum(axis=0), b.sum(axis=0)
        A, b = np.zeros((len(index), len(index))), np.zeros(len(index))
        for i in range(len(self.rows)):
            here, at = self._here(i, index)
            gram, moment = self._multiplied(i)
            A[np.ix_(at, at)] += gram[np.ix_(here, here)]
            b[at] += moment[here]
        return A, b

    def normal_by_fold(self, index: Index) -> tuple[Array, Array]:
        """:meth:`normal` of each fold, shapes (F, k, k) and (F, k)."""
        F, k = len(self.folds), len(index)
        A, b = np.zeros((F, k, k)), np.zeros((F, k))
        for i in range(len(self.rows)):
            (at, columns), weight = self.base_columns(index, i), self._weight(i)
            for f, (first, last) in enumerate(self.fold_edges(i)):
                own, left = columns[:, first:last], self._white[i][first:last]
                A[f][np.ix_(at, at)] += own @ own.T * weight
                b[f][at] += own @ left * weight
        return A, b

    def fold_edges(self, i: int) -> list[tuple[int, int]]:
        """Begin and end of each fold in a joint's samples."""
        edges = self._edges[i].tolist()
        return list(zip(edges[:-1], edges[1:], strict=True))

    def cross_products(
        self, base: Index, wanted: Index, places: Mapping[int, Index]
    ) -> tuple[Array, dict[int, Array], Array]:
        """Weighted cross-products of a base with other columns, the wanted ones.

        ``places`` are the positions in ``wanted`` of blocks of size p, shape (B, p).

        Returns:
            Products of both, shape (k, K); within the blocks of each size, shape
            (B, p, p); and of the wanted columns with the gap, shape (K,).
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
                use = mine[x[:, 0]] >= 0  # all columns of a block reach the same joints
                at = mine[x[use]]
                within[p][use] += gram[at[:, :, None], at[:, None, :]] * weight
        return across, within, moment

    def base_columns(self, base: Index, i: int) -> tuple[Index, Array]:
        """Positions in a base, and whitened columns, of those that reach a joint.

        Those of the last base are kept.
        """
        if self._base[0] != base.tobytes():
            self._base = base.tobytes(), {}
        if i not in self._base[1]:
            self._base[1][i] = self._here(i, base)[1], self.columns_at(i, base)
        return self._base[1][i]

    def columns_at(self, i: int, index: Index) -> Array:
        """Whitened columns of an index that reach a joint, one a row."""
        return self._columns[i][self._here(i, index)[0]]

    def new_products(
        self, base: Index, i: int, x: Array
    ) -> tuple[Index, Array, Array, Array]:
        """Weighted cross-products of new columns at a joint, shape (R, p), with a base.

        Returns:
            Positions of the base columns that reach the joint; products of them with
            the new columns, of the new columns, and of these with the gap.
        """
        new, (target, old) = self._whiten(i, x), self.base_columns(base, i)
        parts = (old @ new, new.T @ new, new.T @ self._white[i])
        across, own, moment = (self._weight(i) * part for part in parts)
        return target, across, own, moment

    def squares(self, index: Index, gains: Array) -> Array:
        """Residual sum of squares of each joint, shape (n,), [N²·m²]."""
        left = [self.residual(i, index, gains) for i in range(len(self.rows))]
        return np.array([x @ x for x in left])

    def _fitted(
        self, i: int, index: Index, gains: Array, part: slice = slice(None)
    ) -> Array:
        """Whitened torque of columns at a joint."""
        at, columns = self.base_columns(index, i)
        return np.asarray(gains[at] @ columns[:, part])

    def weighted_squares(self, index: Index, gains: Array) -> Array:
        """Residual squares of each joint, weighted by the noise, shape (n,)."""
        out = np.zeros(len(self.rows))
        for i, white in enumerate(self._white):
            left = white - self._fitted(i, index, gains)
            out[i] = self._weight(i) * (left @ left)
        return out

    def fitted_squares(self, index: Index, gains: Array) -> Array:
        """Squares of the fitted torque of each joint, weighted by the noise, (n,)."""
        out = np.zeros(len(self.rows))
        for i in range(len(self.rows)):
            torque = self._fitted(i, index, gains)
            out[i] = self._weight(i) * (torque @ torque)
        return out

    def residual(self, i: int, index: Index, gains: Array) -> Array:
        """Residual of a joint, in the order of ``rows[i]``, [N·m]."""
        return self._colour(i, self._white[i] - self._fitted(i, index, gains))


def _enlarged(x: Array, used: int, shape: tuple[int, int]) -> Array:
    """A larger array with the used rows of another one."""
    out = np.empty(shape)
    out[:used, : x.shape[1]] = x[:used]
    return out
