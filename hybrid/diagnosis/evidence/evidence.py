"""How much evidence the gap holds for one more effect.

The gap is a sum of terms, ``left = Z β + Σ C γ + noise``. The simulator's own numbers
(β: link parameters and declared friction) are a few per cent off everywhere, and each
gain γ has a physical size, so both have Gaussian priors; terms are compared by the
marginal likelihood of the gap, in which all gains are integrated out.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array
from hybrid.diagnosis.evidence.bayes import heavy_tailed
from hybrid.diagnosis.evidence.noise import LAGS
from hybrid.diagnosis.evidence.products import Index, Products
from hybrid.diagnosis.evidence.screening import Screening, by_size
from hybrid.diagnosis.gap.gap import Columns, Gap

_NONE = np.zeros(0, dtype=np.intp)
_SCREENS = 4  # that are kept: two bases, and on each causes and unknown laws


@dataclass(frozen=True, eq=False)
class Solution:
    """The most probable gains of some columns.

    Attributes:
        index: Columns in the solution, shape (k,).
        gains: Their values, shape (k,).
        evidence: Log marginal likelihood of the gap, up to a constant, [nat].
    """

    index: Index
    gains: Array
    evidence: float
    _unit: Array
    _factor: tuple[Array, bool]

    @cached_property
    def covariance(self) -> Array:
        """Posterior covariance of the gains, shape (k, k)."""
        unit = self._unit
        return np.asarray(unit[:, None] * cho_solve(self._factor, np.diag(unit)))

    def of(self, columns: Index) -> Array:
        """Gains of some of the columns, in their order."""
        return self.gains[self._rows(columns)]

    def _rows(self, columns: Index) -> Index:
        order = np.argsort(self.index)
        return order[np.searchsorted(self.index[order], columns)]


class Trial(NamedTuple):
    """What columns add to an explanation.

    Attributes:
        worth: Gain in evidence, [nat].
        gains: The most probable gains, shape (p,).
        wider: How many times wider than usual their prior is.
    """

    worth: float
    gains: Array
    wider: float


class Evidence(Products):
    """How much more probable the gap is with some of the columns.

    Args:
        gap: The gap.
        use: Samples that count, shape (M,); all by default.

    Attributes:
        precision: Inverse prior variance of each gain, shape (K,).
        covariances: Of each joint's noise at some lags, shape (p + 1,), [N²·m²].
    """

    def __init__(self, gap: Gap, use: NDArray[np.bool_] | None = None) -> None:
        super().__init__(gap, use)
        self.precision = np.zeros(0)
        self.covariances = [np.ones(LAGS + 1) for _ in self.rows]
        self._size = np.zeros(0)
        self._screened: dict[tuple[bytes, ...], Screening] = {}
        self._factored: tuple[bytes, tuple[Array, bool], Array]
        self._factored = b"", (np.zeros((0, 0)), False), np.zeros(0)

    def add(self, blocks: Sequence[Columns], std: Sequence[Array]) -> list[Index]:
        """Take in columns.

        Args:
            blocks: Columns by joint, shape (M, p) each.
            std: Prior standard deviation of each gain of a block, shape (p,).

        Returns:
            Index of the columns of each block.
        """
        if not blocks:
            return []
        index = self.take(blocks, [len(s) for s in std])
        size = np.concatenate([np.asarray(s, dtype=float) for s in std])
        size = np.maximum(size, 1e-12)
        weight = size**-2.0
        self._size = np.concatenate([self._size, size])
        self.precision = np.concatenate([self.precision, weight])
        return index

    def weigh(self, covariances: Sequence[Array]) -> None:
        """See :meth:`.Products.weigh`."""
        super().weigh(covariances)
        self._screened.clear()
        self._factored = b"", *self._factored[1:]

    def spread(self, index: Index, relative: float) -> None:
        """Set the prior of some gains to a fraction of the size they came with."""
        self.precision[index] = self._size[index] ** -2.0 / relative**2
        self._factored = b"", *self._factored[1:]

    def solve(self, index: Index) -> Solution:
        """Most probable gains of some columns, and the evidence for all of them."""
        A, b = self.normal(index)
        prior = self.precision[index]
        # In units of the prior the matrix is the identity plus what the data say.
        unit = 1.0 / np.sqrt(prior)
        factor = cho_factor(np.eye(len(index)) + unit[:, None] * A * unit)
        gains = unit * cho_solve(factor, unit * b)
        occam = np.log(np.diag(factor[0])).sum()
        return Solution(index, gains, float(0.5 * b @ gains - occam), unit, factor)

    def strain(self, solution: Solution, columns: Index) -> float:
        """Squares of some gains in a solution, in units of their priors."""
        return float(solution.of(columns) ** 2 @ self.precision[columns])

    def left_out(self, index: Index) -> Array:
        """What columns lose on each fold by the gains of all others, shape (2,).

        Squares of the gap over their noise, and weighed by it as a process.
        """
        G, c = self.normal_by_fold(index)
        A, b = G.sum(axis=0) + np.diag(self.precision[index]), c.sum(axis=0)
        gains = np.linalg.solve(A - G, (b - c)[..., None])[..., 0]
        lost = np.zeros(2)
        for i, white in enumerate(self._white):
            left = white.copy()
            for g, (first, last) in zip(gains, self.parts(i), strict=True):
                left[first:last] -= self._fitted(i, index, g, slice(first, last))
            raw = self._coloured(i, left)
            lost += raw @ raw / self.noise[i], left @ left * self._weight(i)
        return lost

    def screen(
        self,
        base: Index,
        blocks: Sequence[Index],
        lower: Sequence[Array],
        made_at: Sequence[Array | None] | None = None,
        less: Index = _NONE,
    ) -> Array:
        """Gain in evidence by each block of columns on top of others, [nat].

        Args:
            base: Columns that are in already.
            blocks: Candidates.
            lower: Smallest physical value of each gain of a candidate.
            made_at: Its gains, where its columns are of these alone; of each.
            less: Columns of the base that are to be left out.
        """
        if not blocks:
            return np.zeros(0)
        wanted = np.concatenate(blocks)
        screening = self._screening(base, wanted, blocks)
        known = made_at or [None] * len(blocks)
        precision, least = self.precision[wanted], np.concatenate(lower)
        return screening.worth(less, precision, least, known)

    def _screening(
        self, base: Index, wanted: Index, blocks: Sequence[Index]
    ) -> Screening:
        """Kept: the same base is asked for once without each of its parts."""
        key = base.tobytes(), wanted.tobytes(), self.precision[base].tobytes()
        if key not in self._screened:
            places = by_size(blocks)
            across, within, moment = self.beside(base, wanted, places)
            across *= 1.0 / np.sqrt(self.precision[base])[:, None]
            products = across, within, moment
            found = Screening.of(base, places, products, *self._factor(base))
            while len(self._screened) >= _SCREENS:
                del self._screened[next(iter(self._screened))]
            self._screened[key] = found
        return self._screened[key]

    def trial(
        self,
        base: Index,
        columns: Columns,
        std: Array,
        lower: Array,
        made_at: Array | None = None,
    ) -> Trial:
        """Gain in evidence by columns that are not in.

        Args:
            base: Columns that are in already.
            columns: Columns by joint, shape (M, p) each.
            std: Prior standard deviation of their gains, shape (p,).
            lower: Smallest physical values of these, shape (p,).
            made_at: Their values, shape (p,), where the columns are of these alone.
        """
        H, s = self._beyond(base, columns, len(std))
        worth, gains, wider = heavy_tailed(H, s, std**-2.0, lower, made_at)
        return Trial(float(worth), gains, float(wider))

    def at(self, base: Index, columns: Columns, gains: Array) -> float:
        """Log-likelihood that columns that are not in add at gains (p,), [nat]."""
        H, s = self._beyond(base, columns, len(gains))
        return float(s @ gains - 0.5 * gains @ H @ gains)

    def _beyond(self, base: Index, columns: Columns, p: int) -> tuple[Array, Array]:
        """Normal matrix and right-hand side of columns, less what others explain."""
        H, s = np.zeros((p, p)), np.zeros(p)
        across = np.zeros((len(base), p))
        for i, x in columns.items():
            target, beside, own, moment = self.cross(base, i, x[self.rows[i]])
            across[target] += beside
            H += own
            s += moment
        factor, b = self._factor(base)
        across /= np.sqrt(self.precision[base])[:, None]
        H -= across.T @ cho_solve(factor, across)
        s -= across.T @ cho_solve(factor, b)
        return H, s

    def _factor(self, base: Index) -> tuple[tuple[Array, bool], Array]:
        """Cholesky factor and right-hand side of some columns, kept for the next.

        Both are in units of the prior.
        """
        key = base.tobytes() + self.noise.tobytes()
        if key != self._factored[0]:
            A, b = self.normal(base)
            unit = 1.0 / np.sqrt(self.precision[base])
            factor = cho_factor(np.eye(len(base)) + unit[:, None] * A * unit)
            self._factored = key, factor, unit * b
        return self._factored[1], self._factored[2]
