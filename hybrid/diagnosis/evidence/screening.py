"""Gain in log evidence by many blocks of columns at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from hybrid.arrays import Array, Index
from hybrid.diagnosis.evidence.bayes import heavy_tailed


@dataclass(frozen=True, eq=False)
class Screening:
    """Cross-products of blocks of columns, with a base eliminated.

    All are in units of the base's prior. Blocks of the same size p are stacked.

    Attributes:
        base: Columns of the base, shape (k,).
        places: Positions of the columns of the blocks of each size, shape (B, p).
        squares: Products within each block, shape (B, p, p).
        moment: Products with the gap, shape (K,).
        regression: Regression of the blocks on the base, shape (k, K).
        covariance: Posterior covariance of the base's gains, shape (k, k).
        gains: Gains of the base, shape (k,).
    """

    base: Index
    places: Mapping[int, Index]
    squares: Mapping[int, Array]
    moment: Array
    regression: Array
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
        """Eliminate a base, with its Cholesky factor, from blocks of columns.

        For the products see :meth:`.Products.cross_products`; ``own`` are those of the
        base with the gap, shape (k,).
        """
        across, within, moment = products
        regression = cho_solve(factor, across, check_finite=False)
        squares = {
            p: within[p] - _inner(across, regression, x) for p, x in places.items()
        }
        gains = cho_solve(factor, own)
        covariance = cho_solve(factor, np.eye(len(base)))
        left = moment - across.T @ gains
        return cls(base, places, squares, left, regression, covariance, gains)

    def _without(self, columns: Index) -> tuple[Mapping[int, Array], Array]:
        """``squares`` and ``moment`` where some columns of the base are left out."""
        if not len(columns):
            return self.squares, self.moment
        out = np.flatnonzero(np.isin(self.base, columns))
        inner, regression = self.covariance[np.ix_(out, out)], self.regression[out]
        both = np.column_stack([regression, self.gains[out]])
        back = np.asarray(np.linalg.solve(inner, both))
        squares = {
            p: self.squares[p] + _inner(regression, back, x)
            for p, x in self.places.items()
        }
        return squares, self.moment + regression.T @ back[:, -1]

    def worth(
        self,
        less: Index,
        precision: Array,
        lower: Array,
        fixed_gains: Sequence[Array | None],
    ) -> Array:
        """Gain in log evidence by each block, shape (B,), [nat].

        The columns ``less`` of the base are left out. ``precision`` and ``lower`` are
        of each column, shape (K,), and ``fixed_gains`` of each block; see
        :func:`.log_bayes`.
        """
        squares, moment = self._without(less)
        starts = np.sort(np.concatenate([x[:, 0] for x in self.places.values()]))
        worth = np.empty(len(starts))
        for places in self.places.values():
            number = np.searchsorted(starts, places[:, 0])  # of each block
            fixed = np.array([fixed_gains[k] is not None for k in number])
            for use, known in ((~fixed, False), (fixed, True)):
                if use.any():
                    own, x = number[use], places[use]
                    at = np.array([fixed_gains[k] for k in own]) if known else None
                    H = squares[places.shape[1]][use]
                    prior = precision[x], lower[x], at
                    worth[own] = heavy_tailed(H, moment[x], *prior)[0]
        return worth


def by_size(blocks: Sequence[Index]) -> dict[int, Index]:
    """Positions of the columns of consecutive blocks, by block size p, (B, p) each."""
    end = np.cumsum([len(x) for x in blocks])
    places: dict[int, list[Index]] = {}
    for x, last in zip(blocks, end, strict=True):
        places.setdefault(len(x), []).append(np.arange(last - len(x), last))
    return {p: np.array(x) for p, x in places.items()}


def _inner(a: Array, b: Array, places: Index) -> Array:
    """Cross-products of two sets of columns within blocks, shape (B, p, p)."""
    one, other = (x[:, places].transpose(1, 2, 0) for x in (a, b))  # (B, p, k)
    return np.asarray(one @ other.transpose(0, 2, 1))
