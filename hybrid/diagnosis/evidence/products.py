"""Cross-products of the gap and the columns that might explain it."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.joint_products import JointProducts
from hybrid.diagnosis.evidence.noise import Noise
from hybrid.diagnosis.gap.gap import Columns, Gap


class Products:
    """Gap and columns of each joint, with their cross-products.

    Columns are stored joint by joint, as most effects reach one joint only. Products
    are weighted by the precision of the noise; only those are computed that a base or a
    block of columns needs.

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

    def __init__(self, gap: Gap, use: Mask | None = None) -> None:
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
        self._joints = [JointProducts(left) for left in self.left]
        self._base: tuple[bytes, dict[int, tuple[Index, Array]]] = b"", {}

    @property
    def power(self) -> Array:
        """Sum of squares of the gap at each joint, shape (n,), [N²·m²]."""
        return np.array([x @ x for x in self.left])

    def add_columns(
        self, blocks: Sequence[Columns], sizes: Sequence[int]
    ) -> list[Index]:
        """Add blocks of columns of some sizes; see :meth:`.Evidence.add`."""
        index, fresh = [], [list[tuple[Array, Index]]() for _ in self.rows]
        for columns, count in zip(blocks, sizes, strict=True):
            own = np.arange(self.size, self.size + count)
            for i, x in columns.items():
                fresh[i].append((x.T, own))
            index.append(own)
            self.size += count
        for joint, rows, parts in zip(self._joints, self.rows, fresh, strict=True):
            joint.add(parts, rows)
        return index

    def set_covariances(
        self, covariances: Sequence[Array], sizes: Array | None = None
    ) -> None:
        """Set the noise processes, by which products are weighted.

        Args:
            covariances: Covariance of each joint's noise at lags from zero on, shape
                (p + 1,), [N²·m²].
            sizes: RMS noise of each sample over that of its process, shape (M, n); one
                by default.
        """
        gap, processes = self.gap, []
        sizes = np.ones(gap.left.shape) if sizes is None else sizes
        each = zip(self.rows, covariances, sizes.T, strict=True)
        for rows, covariance, size in each:
            follows = np.diff(rows, prepend=-2) == 1
            for part in (gap.fold, gap.trajectory):
                follows &= np.diff(part[rows], prepend=-1) == 0
            processes.append(Noise(covariance, follows, size[rows]))
        for joint, process in zip(self._joints, processes, strict=True):
            joint.set_noise(process)
        self._processes = processes

    def set_left(self, left: Array) -> None:
        """Set another gap, shape (M, n), [N·m]; the columns stay."""
        self.left = [left[r, i] for i, r in enumerate(self.rows)]
        for joint, own in zip(self._joints, self.left, strict=True):
            joint.set_left(own)

    def _weight(self, i: int) -> float:
        """Weight of a product: inverse noise variance before processes are set."""
        return 1.0 if self._processes is not None else float(1.0 / self.noise[i])

    def _here(self, i: int, index: Index) -> tuple[Index, Index]:
        """Places of an index's columns at a joint, and their positions in the index."""
        where = np.full(self.size, -1)
        where[index] = np.arange(len(index))
        target = where[self._joints[i].owner]
        here = np.flatnonzero(target >= 0)
        return here, target[here]

    def normal(self, index: Index) -> tuple[Array, Array]:
        """Weighted normal matrix (k, k) and right-hand side (k,) of some columns."""
        A, b = np.zeros((len(index), len(index))), np.zeros(len(index))
        for i in range(len(self.rows)):
            at, own, moment = self._normal_at(i, index)
            A[np.ix_(at, at)] += own
            b[at] += moment
        return A, b

    def _normal_at(self, i: int, index: Index) -> tuple[Index, Array, Array]:
        """Part of a joint in :meth:`normal`, and the positions of its columns."""
        here, at = self._here(i, index)
        joint, weight = self._joints[i], self._weight(i)
        return at, joint.across(here, here) * weight, joint.moment(here) * weight

    def normal_by_fold(self, index: Index) -> tuple[Array, Array]:
        """:meth:`normal` of each fold, shapes (F, k, k) and (F, k)."""
        F, k = len(self.folds), len(index)
        A, b = np.zeros((F, k, k)), np.zeros((F, k))
        for i, joint in enumerate(self._joints):
            at, columns = self.base_columns(index, i)
            columns, left = joint.whiten(columns.T).T, joint.whiten(joint.left)
            for f, (first, last) in enumerate(self.fold_edges(i)):
                own = columns[:, first:last]
                A[f][np.ix_(at, at)] += own @ own.T * self._weight(i)
                b[f][at] += own @ left[first:last] * self._weight(i)
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
        for i, joint in enumerate(self._joints):
            (here, k), (there, m) = self._here(i, base), self._here(i, wanted)
            across[np.ix_(k, m)] += joint.across(here, there) * self._weight(i)
            moment[m] += joint.moment(there) * self._weight(i)
            mine = np.full(len(wanted), -1)
            mine[m] = there
            for p, x in places.items():
                use = mine[x[:, 0]] >= 0  # all columns of a block reach the same joints
                within[p][use] += joint.within(mine[x[use]]) * self._weight(i)
        return across, within, moment

    def base_columns(self, base: Index, i: int) -> tuple[Index, Array]:
        """Positions in a base of columns that reach a joint, and these, one a row.

        Those of the last base are kept.
        """
        if self._base[0] != base.tobytes():
            self._base = base.tobytes(), {}
        if i not in self._base[1]:
            here, at = self._here(i, base)
            self._base[1][i] = at, self._joints[i].columns(here)
        return self._base[1][i]

    def new_products(
        self, base: Index, i: int, x: Array
    ) -> tuple[Index, Array, Array, Array]:
        """Weighted cross-products of new columns at a joint, shape (R, p), with a base.

        Returns:
            Positions of the base columns that reach the joint; products of them with
            the new columns, of the new columns, and of these with the gap.
        """
        at, columns = self.base_columns(base, i)
        across, own, moment = self._joints[i].products(x, columns)
        weight = self._weight(i)
        return at, across * weight, own * weight, moment * weight

    def squares(self, index: Index, gains: Array) -> Array:
        """Residual sum of squares of each joint, shape (n,), [N²·m²]."""
        left = [self.residual(i, index, gains) for i in range(len(self.rows))]
        return np.array([x @ x for x in left])

    def weighted_squares(self, index: Index, gains: Array) -> Array:
        """Residual squares of each joint, weighted by the noise, shape (n,)."""
        return self._weighted(
            self.residual(i, index, gains) for i in range(len(self.rows))
        )

    def fitted_squares(self, index: Index, gains: Array) -> Array:
        """Squares of the fitted torque of each joint, weighted by the noise, (n,)."""
        return self._weighted(
            self.fitted(i, index, gains) for i in range(len(self.rows))
        )

    def _weighted(self, torques: Iterable[Array]) -> Array:
        """Squares of each joint's torque, weighted by the noise, shape (n,)."""
        white = [j.whiten(x) for j, x in zip(self._joints, torques, strict=True)]
        return np.array([self._weight(i) * (x @ x) for i, x in enumerate(white)])

    def fitted(
        self, i: int, index: Index, gains: Array, part: slice = slice(None)
    ) -> Array:
        """Torque of some columns at a joint, in the order of ``rows[i]``, [N·m]."""
        at, columns = self.base_columns(index, i)
        return np.asarray(gains[at] @ columns[:, part])

    def residual(self, i: int, index: Index, gains: Array) -> Array:
        """Residual of a joint, in the order of ``rows[i]``, [N·m]."""
        return np.asarray(self.left[i] - self.fitted(i, index, gains))
