"""Columns of one joint, with their cross-products."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.noise import Noise

_ROOM = 2.5  # allocated over needed memory, so that little is copied
_CHUNK = 64  # columns that are whitened at a time


class JointProducts:
    """Columns of one joint, with their products weighted by the noise's precision.

    Only products with columns of a base and products within blocks are computed.

    Args:
        left: The gap, shape (R,), [N·m].

    Attributes:
        owner: Number of each column, shape (K,).
    """

    def __init__(self, left: Array) -> None:
        self.left = left
        self.owner = np.zeros(0, dtype=np.intp)
        self._first = np.zeros(0, dtype=np.intp)  # column of each column's block
        self._memory = np.zeros((0, len(left)))  # columns, one a row
        self.set_noise(None)

    def set_noise(self, noise: Noise | None) -> None:
        """Weight all products by a noise process, or by none."""
        self._noise = noise
        self._weighted_left = self._weighted(self.left)
        self._moment = np.zeros(0)
        self._near = np.zeros((0, 1))  # products with the next columns of a block
        self._row = np.full(len(self.owner), -1)  # of each column in the next two
        self._base = np.zeros((0, len(self.left)))  # weighted columns, with room
        self._across = np.zeros((0, 0))

    def set_left(self, left: Array) -> None:
        """Set another gap, shape (R,), [N·m]."""
        self.left, self._weighted_left = left, self._weighted(left)
        self._moment = self._memory[: len(self._moment)] @ self._weighted_left

    @property
    def power(self) -> float:
        """Product of the gap with itself, weighted by the noise's precision."""
        return float(self.left @ self._weighted_left)

    def whiten(self, x: Array) -> Array:
        """Whitened samples, shape (R, ...)."""
        return x if self._noise is None else self._noise.whiten(x)

    def _weighted(self, x: Array) -> Array:
        """Samples times the precision of the noise, shape (R, ...)."""
        return x if self._noise is None else self._noise.weight(x)

    def add(self, blocks: Sequence[tuple[Array, Index]], rows: Index) -> None:
        """Add some rows (R,) of blocks of columns, (p, M), with their numbers."""
        at = len(self.owner)
        size = at + sum(len(x) for x, _ in blocks)
        if size > len(self._memory):
            self._memory = _enlarged(self._memory, at, size)
        owner, first = [self.owner], [self._first]
        for x, numbers in blocks:
            # With another mode NumPy would buffer the output.
            x.take(rows, axis=1, out=self._memory[at : at + len(x)], mode="clip")
            owner.append(numbers)
            first.append(np.full(len(x), at))
            at += len(x)
        self.owner, self._first = np.concatenate(owner), np.concatenate(first)

    def columns(self, places: Index) -> Array:
        """Some columns, one a row."""
        return self._memory[places]

    def moment(self, places: Index) -> Array:
        """Products of some columns with the gap, shape (k,)."""
        self._update()
        return np.asarray(self._moment[places])

    def within(self, blocks: Index) -> Array:
        """Products within blocks of p columns, (B, p) places, shape (B, p, p)."""
        self._update()
        one, other = blocks[:, :, None], blocks[:, None, :]
        return np.asarray(self._near[np.minimum(one, other), np.abs(one - other)])

    def across(self, base: Index, places: Index) -> Array:
        """Products of the columns of a base with others, shape (k, m)."""
        self._update()
        new = base[self._row[base] < 0]
        if len(new):
            used, size = len(self._across), len(self._across) + len(new)
            if size > len(self._base):
                self._base = _enlarged(self._base, used, size)
            self._base[used:size] = self._weighted(self._memory[new].T).T
            more = self._base[used:size] @ self._memory[: len(self.owner)].T
            self._across = np.concatenate([self._across, more])
            self._row[new] = np.arange(used, size)
        return np.asarray(self._across[np.ix_(self._row[base], places)])

    def products(self, x: Array, base: Array) -> tuple[Array, Array, Array]:
        """Products of other columns, shape (R, p), with a base's columns, one a row.

        Returns:
            Those with the base, shape (k, p); within them; and with the gap, (p,).
        """
        white = self.whiten(x)
        weighted = x if self._noise is None else self._noise.weight_white(white)
        return base @ weighted, white.T @ white, self._weighted_left @ x

    def _update(self) -> None:
        """Compute the products of columns that are new since the last time."""
        done, size = len(self._moment), len(self.owner)
        if done == size:
            return
        new = self._memory[done:size]
        self._moment = np.concatenate([self._moment, new @ self._weighted_left])
        more = self._base[: len(self._across)] @ new.T
        self._across = np.concatenate([self._across, more], axis=1)
        self._row = np.concatenate([self._row, np.full(len(new), -1)])
        first, length = np.unique(self._first[done:], return_counts=True)
        widest = max(self._near.shape[1], int(length.max()))
        near = np.zeros((size, widest))
        near[:done, : self._near.shape[1]] = self._near
        for p in np.unique(length):
            blocks = first[length == p]
            for k in range(0, len(blocks), max(1, _CHUNK // p)):
                start = blocks[k : k + max(1, _CHUNK // p)]
                own = self._memory[(start[:, None] + np.arange(p)).ravel()]
                white = np.ascontiguousarray(self.whiten(own.T).T).reshape(
                    len(start), p, -1
                )
                gram = white @ white.transpose(0, 2, 1)
                for a in range(p):
                    near[start + a, : p - a] = gram[:, a, a:]
        self._near = near


def _enlarged(x: Array, used: int, size: int) -> Array:
    """The used rows of an array, with room for a larger number of them."""
    out = np.empty((round(_ROOM * size), x.shape[1]))
    out[:used] = x[:used]
    return out
