"""The log marginal likelihood of the gap, for any columns.

The gap is a sum of terms, ``left = Z β + Σ C γ + noise``. The errors β of the file's
numbers are small, and each gain γ has a physical size: both have Gaussian priors, and
are integrated out.

Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415 (evidence and its Occam factor).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hybrid.arrays import Array, Index, Mask
from hybrid.diagnosis.evidence.bayes import heavy_tailed
from hybrid.diagnosis.evidence.noise import LAGS
from hybrid.diagnosis.evidence.products import Products
from hybrid.diagnosis.evidence.screening import Screening, by_size
from hybrid.diagnosis.gap.gap import Columns, Gap

_NONE = np.zeros(0, dtype=np.intp)
_LEAST_STD = 1e-12  # SI units: a gain that is known, as of a link without a mass
_SCREENS = 4  # kept screenings: of two bases, for candidates and for unknown laws


@dataclass(frozen=True, eq=False)
class Solution:
    """The most probable gains of some columns.

    Attributes:
        index: The columns, shape (k,).
        gains: Their gains, shape (k,).
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
        """Gains of some of the columns, in their order, shape (p,)."""
        return self.gains[self._at(columns)]

    def std(self, columns: Index) -> Array:
        """Posterior standard deviations of the gains of some of the columns, (p,)."""
        at = self._at(columns)
        unit = np.zeros((len(self.index), len(at)))
        unit[at, np.arange(len(at))] = self._unit[at]
        return np.asarray(np.sqrt(np.sum(unit * cho_solve(self._factor, unit), axis=0)))

    def _at(self, columns: Index) -> Index:
        order = np.argsort(self.index)
        return np.asarray(order[np.searchsorted(self.index[order], columns)])


class Trial(NamedTuple):
    """Result of a trial of new columns beside a base.

    Attributes:
        worth: Gain in log evidence, [nat].
        gains: The most probable gains, shape (p,).
        prior_factor: Factor by which their prior is widened.
    """

    worth: float
    gains: Array
    prior_factor: float


class Evidence(Products):
    """Log marginal likelihoods of the gap, given some of the columns.

    Args:
        use: Samples that are used, shape (M,); all by default.

    Attributes:
        precision: Inverse prior variance of each gain, shape (K,).
        covariances: Estimated covariance of each joint's noise at lags from zero on,
            shape (p + 1,), [N²·m²].
    """

    def __init__(self, gap: Gap, use: Mask | None = None) -> None:
        super().__init__(gap, use)
        self.precision = np.zeros(0)
        self.covariances = [np.ones(LAGS + 1) for _ in self.rows]
        self._size = np.zeros(0)
        self._screened: dict[tuple[bytes, ...], Screening] = {}
        self._factored: tuple[bytes, tuple[Array, bool], Array]
        self._factored = b"", (np.zeros((0, 0)), False), np.zeros(0)

    def add(self, blocks: Sequence[Columns], std: Sequence[Array]) -> list[Index]:
        """Add columns with the prior of their gains.

        Args:
            blocks: Columns by joint, shape (M, p) each.
            std: Prior standard deviation of each gain of a block, shape (p,).

        Returns:
            Numbers of the columns of each block.
        """
        if not blocks:
            return []
        index = self.add_columns(blocks, [len(s) for s in std])
        size = np.maximum(np.concatenate(std), _LEAST_STD)
        self._size = np.concatenate([self._size, size])
        self.precision = np.concatenate([self.precision, size**-2.0])
        return index

    def set_covariances(
        self, covariances: Sequence[Array], sizes: Array | None = None
    ) -> None:
        """See :meth:`.Products.set_covariances`."""
        super().set_covariances(covariances, sizes)
        self._forget()

    def set_left(self, left: Array) -> None:
        """See :meth:`.Products.set_left`."""
        super().set_left(left)
        self._forget()

    def _forget(self) -> None:
        """Forget what was worked out with another gap or other noise."""
        self._screened.clear()
        self._factored = b"", *self._factored[1:]

    def scale_prior(self, index: Index, factor: float) -> None:
        """Set prior standard deviations to a factor times those given at first."""
        self.precision[index] = self._size[index] ** -2.0 / factor**2
        self._factored = b"", *self._factored[1:]

    def solve(self, index: Index) -> Solution:
        """Most probable gains of some columns, and their log evidence."""
        A, b = self.normal(index)
        # In units of the prior, in which the matrix is well conditioned.
        unit = 1.0 / np.sqrt(self.precision[index])
        factor = cho_factor(np.eye(len(index)) + unit[:, None] * A * unit)
        gains = unit * cho_solve(factor, unit * b)
        occam = np.log(np.diag(factor[0])).sum()
        return Solution(index, gains, float(0.5 * b @ gains - occam), unit, factor)

    def determined(self, solution: Solution, i: int) -> float:
        """Number of gains that the samples of a joint determine, and not their prior.

        Source: MacKay 1992, doi 10.1162/neco.1992.4.3.415.
        """
        at, A, _ = self._normal_at(i, solution.index)
        return float(np.sum(A * solution.covariance[np.ix_(at, at)]))

    def left_squares(self, solution: Solution, i: int) -> float:
        """Squares that a solution leaves at a joint, weighted by the noise.

        They are those of :meth:`weighted_squares`, worked out without the samples.
        """
        at, A, b = self._normal_at(i, solution.index)
        gains, whole = solution.gains[at], self._joints[i].power * self._weight(i)
        return max(float(whole - 2 * b @ gains + gains @ A @ gains), 0.0)

    def residuals(self, index: Index, gains: Array | None = None) -> list[Array]:
        """Residual of each joint, [N·m]; at the most probable gains by default."""
        gains = self.solve(index).gains if gains is None else gains
        return [self.residual(i, index, gains) for i in range(len(self.rows))]

    def prior_squares(self, solution: Solution, columns: Index) -> float:
        """Sum of squared gains of some columns over their prior variances."""
        return float(solution.of(columns) ** 2 @ self.precision[columns])

    def held_out_residuals(self, index: Index) -> list[Array]:
        """Cross-validated residual of each joint, in the order of its rows, [N·m].

        Each fold is predicted with the gains of all others.
        """
        G, c = self.normal_by_fold(index)
        A, b = G.sum(axis=0) + np.diag(self.precision[index]), c.sum(axis=0)
        gains = np.linalg.solve(A - G, (b - c)[..., None])[..., 0]
        residuals = [x.copy() for x in self.left]
        for i, left in enumerate(residuals):
            for g, (first, last) in zip(gains, self.fold_edges(i), strict=True):
                left[first:last] -= self.fitted(i, index, g, slice(first, last))
        return residuals

    def held_out_losses(self, index: Index) -> Array:
        """Cross-validated squares of each fold over the noise variance, shape (F, 2).

        The first loss takes samples as independent, the second one is of whitened
        samples.
        """
        losses = np.zeros((len(self.folds), 2))
        for i, left in enumerate(self.held_out_residuals(index)):
            weights = 1.0 / self.noise[i], self._weight(i)
            for k, x in enumerate((left, self._joints[i].whiten(left))):
                parts = [x[first:last] for first, last in self.fold_edges(i)]
                losses[:, k] += weights[k] * np.array([y @ y for y in parts])
        return losses

    def screen(
        self,
        base: Index,
        blocks: Sequence[Index],
        lower: Sequence[Array],
        fixed_gains: Sequence[Array | None] | None = None,
        less: Index = _NONE,
    ) -> Array:
        """Gain in log evidence by each block of columns beside a base, [nat].

        For the bounds and ``fixed_gains`` of each block see :func:`.log_bayes`. The
        columns ``less`` of the base are left out.
        """
        if not blocks:
            return np.zeros(0)
        wanted = np.concatenate(blocks)
        screening = self._screening(base, wanted, blocks)
        fixed = fixed_gains or [None] * len(blocks)
        precision, least = self.precision[wanted], np.concatenate(lower)
        return screening.worth(less, precision, least, fixed)

    def _screening(
        self, base: Index, wanted: Index, blocks: Sequence[Index]
    ) -> Screening:
        """Screening of blocks beside a base; the last ones are kept."""
        key = base.tobytes(), wanted.tobytes(), self.precision[base].tobytes()
        if key not in self._screened:
            places = by_size(blocks)
            across, within, moment = self.cross_products(base, wanted, places)
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
        fixed_gains: Array | None = None,
    ) -> Trial:
        """Try new columns, shape (M, p) at each joint, beside a base.

        ``std`` are the prior standard deviations of their gains, shape (p,). For the
        bounds and ``fixed_gains`` see :func:`.log_bayes`.
        """
        H, s = self._schur_complement(base, columns, len(std))
        precision = np.maximum(std, _LEAST_STD) ** -2.0
        worth, gains, factor = heavy_tailed(H, s, precision, lower, fixed_gains)
        return Trial(float(worth), gains, float(factor))

    def log_likelihood(self, base: Index, columns: Columns, gains: Array) -> float:
        """Gain in log likelihood by new columns with given gains (p,), [nat]."""
        H, s = self._schur_complement(base, columns, len(gains))
        return float(s @ gains - 0.5 * gains @ H @ gains)

    def _schur_complement(
        self, base: Index, columns: Columns, p: int
    ) -> tuple[Array, Array]:
        """Normal matrix and right-hand side of new columns, the base eliminated."""
        H, s = np.zeros((p, p)), np.zeros(p)
        across = np.zeros((len(base), p))
        for i, x in columns.items():
            target, both, own, moment = self.new_products(base, i, x[self.rows[i]])
            across[target] += both
            H += own
            s += moment
        factor, b = self._factor(base)
        across /= np.sqrt(self.precision[base])[:, None]
        H -= across.T @ cho_solve(factor, across)
        s -= across.T @ cho_solve(factor, b)
        return H, s

    def _factor(self, base: Index) -> tuple[tuple[Array, bool], Array]:
        """Cholesky factor and right-hand side of a base, in units of the prior.

        Those of the last base are kept.
        """
        key = base.tobytes() + self.noise.tobytes()
        if key != self._factored[0]:
            A, b = self.normal(base)
            unit = 1.0 / np.sqrt(self.precision[base])
            factor = cho_factor(np.eye(len(base)) + unit[:, None] * A * unit)
            self._factored = key, factor, unit * b
        return self._factored[1], self._factored[2]
