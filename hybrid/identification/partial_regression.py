"""Partial regression: the gain of one more term, with all other terms fitted again.

A new column may be nearly collinear with others: a slow ripple looks like gravity. So
its gain is found together with all other terms at all joints. That needs cross-products
only, so many columns can be tried.

Source: Liang and Zeger 1986, doi 10.1093/biomet/73.1.13 (noise that is correlated
within blocks).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from hybrid.arrays import Array, Index
from hybrid.identification.solution import Solution
from hybrid.regression.least_squares import pseudo_solve


@dataclass(frozen=True)
class PartialRegression:
    """The regression of one joint's residual on its columns and on a new pair of them.

    Attributes:
        others: Normal matrix and right side of the other joints on each fold, shapes
            (F, p, p) and (F, p), in units of this joint's variance.
        support: Unknowns that change this joint's torque, shape (d,).
        columns: Their columns, shape (d, M).
        residual: Residual of the present values, shape (M,), [N·m].
    """

    others: tuple[Array, Array]
    support: Index
    columns: Array
    residual: Array

    @classmethod
    def of(cls, solution: Solution, joint: int, rows: Array) -> PartialRegression:
        """The regression of a joint about the values of a solution.

        Rows are its columns, then the residual of the solution, shape (d + 1, M).
        """
        products, theta = solution.products, solution.weighted.theta
        variance = np.diag(solution.sigma)
        weight = np.diag(variance[joint] / np.maximum(variance, 1e-300))
        weight[joint, joint] = 0.0
        A, b = products.normal(weight, products.folds)
        support = solution.problem.support[joint]
        return cls((A, b - A @ theta), support, rows[:-1], rows[-1])

    def with_wave(self, wave: Array) -> PartialRegression:
        """The same with one more pair of columns, shape (2, M), at its best gains."""
        A, b = self.others
        size = A.shape[1]
        return replace(
            self,
            others=(np.pad(A, ((0, 0), (0, 2), (0, 2))), np.pad(b, ((0, 0), (0, 2)))),
            support=np.append(self.support, [size, size + 1]),
            columns=np.concatenate([self.columns, wave]),
            residual=self.residual - self._fitted(wave)[0] @ wave,
        )

    def cross_validated(
        self, waves: Sequence[Array], fold: Index
    ) -> tuple[Array, Array]:
        """Squared residuals on each fold of the samples by a fit on the other folds.

        They are those without a new pair of columns, shape (F,), and with each of K
        pairs, shape (K, F), [N²·m²].
        """
        folds, d = len(self.others[0]), len(self.columns)
        every = np.concatenate([self.columns, *waves, self.residual[None]])
        parts = [every[:, fold == k] for k in range(folds)]
        sums = np.array([x @ x.T for x in parts])
        pairs = [[], *([first, first + 1] for first in range(d, len(every) - 1, 2))]
        squares = np.empty((len(pairs), folds))
        for k, own in enumerate(sums):
            rest = sums.sum(axis=0) - own
            others = [x.sum(axis=0) - x[k] for x in self.others]
            for i, pair in enumerate(pairs):
                rows = np.ix_(*2 * [[*range(d), *pair, len(every) - 1]])
                N, h, at = self._normal(rest[rows], *others)
                c = np.append(-pseudo_solve(N, h)[at], 1.0)
                squares[i, k] = c @ own[rows] @ c
        return squares[0], squares[1:]

    def is_significant(self, wave: Array, block: Index, chance: float) -> bool:
        """F-test: whether the gains of a pair of columns differ from zero.

        Noise, which may be correlated within a block of samples, passes by ``chance``.
        """
        gains, inverse, slopes, rest = self._fitted(wave)
        if _ridge(wave @ wave.T) * np.linalg.norm(inverse, 2) > 0.5:
            return False  # collinear with the other terms
        _, label = np.unique(block, return_inverse=True)
        scores = np.array([np.bincount(label, weights=x * rest) for x in slopes])
        count = scores.shape[1]
        if count <= 2:
            return False
        covariance = scores @ scores.T * count / (count - 1)
        ratio = gains @ np.linalg.solve(covariance, gains) / 2
        return bool(ratio > fdtri(2, count - 2, 1 - chance))

    def _fitted(self, wave: Array) -> tuple[Array, Array, Array, Array]:
        """Gains of a pair of columns with all other terms fitted again.

        Returns:
            Gains, shape (2,), their block of the inverse normal matrix, their change by
            the torque of each sample, shape (2, M), and the residual, shape (M,).
        """
        rows = np.concatenate([self.columns, wave, self.residual[None]])
        N, h, at = self._normal(rows @ rows.T, *(x.sum(axis=0) for x in self.others))
        pair = np.eye(len(h))[:, -2:]
        theta, *inverse = pseudo_solve(N, np.column_stack([h, pair]))[at].T
        slopes = np.array(inverse) @ rows[:-1]
        residual = rows[-1] - theta @ rows[:-1]
        return theta[-2:], np.array(inverse)[:, -2:], slopes, residual

    def _normal(self, sums: Array, A: Array, b: Array) -> tuple[Array, Array, Index]:
        """Normal matrix and right side of all joints, and where this joint is in them.

        The sums are those of its columns, a new pair or none, and its residual; A and b
        are those of the other joints.
        """
        new = len(sums) - len(self.columns) - 1
        normal, moment = np.pad(A, (0, new)), np.pad(b, (0, new))
        at = np.append(self.support, len(b) + np.arange(new))
        normal[np.ix_(at, at)] += sums[:-1, :-1]
        moment[at] += sums[:-1, -1]
        if new:
            normal[-2:, -2:] += _ridge(sums[-3:-1, -3:-1]) * np.eye(2)
        return normal, moment, at


def _ridge(G: Array) -> float:
    """A small share of the power of a pair, with which a collinear one is solvable."""
    return float(1e-6 * np.trace(G) + 1e-12)
