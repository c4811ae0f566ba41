"""What many blocks of columns would add to others, all at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import heavy_tailed
from hybrid.diagnosis.evidence.products import Index


@dataclass(frozen=True, eq=False)
class Screening:
    """Cross-products of blocks of columns, less what a base explains of them.

    All are in units of the prior of the base. Blocks of one size p are done at once.

    Attributes:
        base: Columns of the base, shape (k,).
        places: Which of the blocks' columns a block of a size has, shape (B, p).
        squares: Products within each block, shape (B, p, p).
        moment: Products with the gap, shape (K,).
        taken: The base's regression on the blocks, shape (k, K).
        covariance: Posterior covariance of the base's gains, shape (k, k).
        gains: These gains, shape (k,).
    """

    base: Index
    places: Mapping[int, Index]
    squares: Mapping[int, Array]
    moment: Array
    taken: Array
    covariance: Array
    gains: Array

    @classmethod
    def of(
        cls,
        base: Index,
        places: Mapping[int, Index],
        products: tuple[Array, Mapping[int, Array], Array],
        factor: tuple[Array, bool],
        own: Array,
    ) -> Screening:
        """Screen blocks of columns.

        Args:
            base: Columns of the base, shape (k,).
            places: Columns of the blocks of each size, shape (B, p).
            products: Of base and blocks (k, K), within the blocks of each size
                (B, p, p), and of the blocks with the gap (K,).
            factor: Cholesky factor of the base.
            own: Its products with the gap, shape (k,).
        """
        across, within, moment = products
        taken = cho_solve(factor, across, check_finite=False)
        squares = {p: within[p] - _inner(across, taken, x) for p, x in places.items()}
        gains = cho_solve(factor, own)
        covariance = cho_solve(factor, np.eye(len(base)))
        left = moment - across.T @ gains
        return cls(base, places, squares, left, taken, covariance, gains)

    def less(self, columns: Index) -> tuple[Mapping[int, Array], Array]:
        """Products within the blocks, and with the gap, beside less of the base.

        Args:
            columns: Columns of the base that are not to be in it.
        """
        if not len(columns):
            return self.squares, self.moment
        out = np.flatnonzero(np.isin(self.base, columns))
        inner, taken = self.covariance[np.ix_(out, out)], self.taken[out]
        both = np.column_stack([taken, self.gains[out]])
        back = np.asarray(np.linalg.solve(inner, both))
        squares = {
            p: self.squares[p] + _inner(taken, back, x) for p, x in self.places.items()
        }
        return squares, self.moment + taken.T @ back[:, -1]

    def worth(
        self,
        less: Index,
        precision: Array,
        lower: Array,
        made_at: Sequence[Array | None],
    ) -> Array:
        """Gain in evidence by each block, shape (B,), [nat].

        Args:
            less: Columns of the base that are not to be in it.
            precision: Inverse prior variance of each column's gain, shape (K,).
            lower: Smallest physical value of each, shape (K,).
            made_at: A block's gains, where its columns are of these alone; of each.
        """
        squares, moment = self.less(less)
        starts = np.sort(np.concatenate([x[:, 0] for x in self.places.values()]))
        worth = np.empty(len(starts))
        for places in self.places.values():
            number = np.searchsorted(starts, places[:, 0])  # of these blocks
            fixed = np.array([made_at[k] is not None for k in number])
            for use, known in ((~fixed, False), (fixed, True)):
                if use.any():
                    own, x = number[use], places[use]
                    at = np.array([made_at[k] for k in own]) if known else None
                    H = squares[places.shape[1]][use]
                    prior = precision[x], lower[x], at
                    worth[own] = heavy_tailed(H, moment[x], *prior)[0]
        return worth


def by_size(blocks: Sequence[Index]) -> dict[int, Index]:
    """Places of the columns of blocks, one after the other, by size p, (B, p) each."""
    end = np.cumsum([len(x) for x in blocks])
    places: dict[int, list[Index]] = {}
    for x, last in zip(blocks, end, strict=True):
        places.setdefault(len(x), []).append(np.arange(last - len(x), last))
    return {p: np.array(x) for p, x in places.items()}


def _inner(a: Array, b: Array, places: Index) -> Array:
    """Products of two sets of columns within blocks, shape (B, p, p)."""
    one, other = (x[:, places].transpose(1, 2, 0) for x in (a, b))  # (B, p, k)
    return np.asarray(one @ other.transpose(0, 2, 1))
