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
from hybrid.diagnosis.evidence.bayes import heavy_tailed, quiet
from hybrid.diagnosis.evidence.noise import LAGS, autocovariance
from hybrid.diagnosis.evidence.products import Index, Products, slices
from hybrid.diagnosis.evidence.screening import Screening, by_size
from hybrid.diagnosis.gap.gap import Columns, Gap
from hybrid.signals import memory

_NONE = np.zeros(0, dtype=np.intp)
_SCREENS = 4  # that are kept: two bases, and on each causes and unknown laws
_EXACT = 0.002  # of the torque: nearer than that no two solvers are
_LESS = 0.9  # of a variance: what is worth another search
# For columns of unit length.
_RIDGES = 10.0 ** np.arange(-5, 5)


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
        for i, edges in enumerate(self._edges):
            left = self._white[i].copy()
            for g, (first, last) in zip(gains, slices(edges), strict=True):
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

    def estimate_noise(self, index: Index) -> None:
        """Noise of each joint: what all columns together miss on folds left out.

        The variance counts as often as the residual is alike in a row: the weights then
        belong to independent samples. It is never less than what the integration of
        the same model by other steps is off by.
        """
        for i, (row, owner) in enumerate(zip(self.rows, self._owner, strict=True)):
            if not len(row):
                continue
            here = np.flatnonzero(np.isin(owner, index))
            back = np.argsort(row)
            left, noise, least = self._flexible(i, here, back)
            found = [(noise, left, row[back])]
            # A few events may be all of that, and spoil the regression as well.
            for x in (left, self.left[i][back]):
                calm = quiet(x, row[back], self.gap.rate)
                if not calm.all():
                    usual = memory(x[calm], row[back][calm]) * np.mean(x[calm] ** 2)
                    found.append((float(usual), x[calm], row[back][calm]))
            noise, x, own = min(found, key=lambda x: x[0])
            self.noise[i] = max(noise, self._least_noise(i, least))
            covariance = autocovariance(x, own, LAGS)
            covariance *= noise / max(memory(x, own) * covariance[0], 1e-300)
            self.covariances[i] = covariance

    def lower_noise(self, measured: Array, index: Index) -> Array:
        """Take what some columns leave for noise where it is less than that so far.

        Args:
            measured: Noise of each joint so far, shape (n,), [N²·m²].
            index: Columns of an explanation.

        Returns:
            Noise of each joint now, shape (n,), [N²·m²].
        """
        found, noise = self.solve(index), measured.copy()
        for i, row in enumerate(self.rows):
            if not len(row):
                continue
            back = np.argsort(row)
            left = self.residual(i, found.index, found.gains)[back]
            taken = int(np.isin(self._owner[i], index).sum())
            left /= max(1.0 - taken / self._dimensions(i), 1e-3)
            alike = memory(left, row[back])
            power = float(left @ left) / len(row)
            if power < _LESS * self.covariances[i][0]:
                noise[i] = max(power * alike, self._least_noise(i, alike))
                self.covariances[i] = autocovariance(left, row[back], LAGS)
        return noise

    def _dimensions(self, i: int) -> float:
        """Of a joint's samples: filtered noise has fewer than samples."""
        band = min(2.0 * self.gap.cutoff / self.gap.rate, 1.0)
        return max(len(self.rows[i]) * band, 1.0)

    def _by_fold(self, i: int, here: Index) -> tuple[Array, Array]:
        """Products of a joint's columns, and with the gap, on each fold."""
        own, left = self._columns[i][:, : len(self._owner[i])][:, here], self.left[i]
        parts = [(own[a:b], left[a:b]) for a, b in slices(self._edges[i])]
        pairs = [(x.T @ x, x.T @ y) for x, y in parts]
        return np.array([g for g, _ in pairs]), np.array([m for _, m in pairs])

    def _least_noise(self, i: int, alike: float) -> float:
        torque = self.gap.measured[self.rows[i], i]
        return max(_EXACT**2 * float(np.mean(torque**2)) * alike, 1e-12)

    def _flexible(self, i: int, here: Index, back: Index) -> tuple[Array, float, float]:
        """Ridge regression of a joint's gap on many columns, by the best ridge.

        Args:
            i: Joint.
            here: Which of its columns.
            back: Order of its samples in time, shape (R,).

        Returns:
            What it leaves in time, larger by what so many columns take from noise
            alone, shape (R,); the mean square that it leaves on each fold if fitted to
            the others, times the memory of what it leaves, [N²·m²]; and that memory.

        Source: Golub, Heath, Wahba 1979, doi 10.1080/00401706.1979.10489751 (what a
        ridge takes from noise).
        """
        G, c = self._by_fold(i, here)
        size = np.sqrt(np.maximum(np.diagonal(G.sum(axis=0)), 1e-300))
        G, c = G / size / size[:, None], c / size
        A, b, folds = G.sum(axis=0), c.sum(axis=0), list(zip(G, c, strict=True))
        row, columns = self.rows[i][back], self._columns[i][:, : len(self._owner[i])]
        weights, found = np.zeros(columns.shape[1]), []
        for ridge in _RIDGES:
            w = np.array([_ridge(A - g, b - x, ridge) for g, x in folds])
            power = np.einsum("fk,fk->", w, (G @ w[..., None])[..., 0] - 2 * c)
            weights[here] = _ridge(A.copy(), b, ridge) / size
            left = (self.left[i] - columns @ weights)[back]
            alike = memory(left, row)
            variance = (self.left[i] @ self.left[i] + power) / len(row)
            found.append((left, variance * alike, alike, ridge))
        left, noise, alike, ridge = min(found, key=lambda x: x[1])
        kept = ridge * np.trace(_ridge(A, np.eye(len(A)), ridge))
        taken = (len(A) - kept) / self._dimensions(i)
        return left / max(1.0 - taken, 1e-3), noise, alike


def _ridge(A: Array, b: Array, ridge: float) -> Array:
    """Weights of a ridge regression; overwrites the normal matrix."""
    A.flat[:: len(A) + 1] += ridge
    # Its transpose is in the order that LAPACK works in, so that nothing is copied.
    factor = cho_factor(A.T, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(cho_solve(factor, b, check_finite=False))
