"""Partial regression: the gain of one more term, with all other terms fitted again.

A new column may be nearly collinear with others: a slow ripple looks like gravity. So
its gain is found together with all other terms at all joints. That needs cross-products
only, so many columns can be tried.

Source: Frisch and Waugh 1933, doi 10.2307/1907330; Liang and Zeger 1986,
doi 10.1093/biomet/73.1.13 (noise that is correlated within blocks).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import fdtri

from hybrid.arrays import Array
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
    support: NDArray[np.intp]
    columns: Array
    residual: Array

    @classmethod
    def of(cls, solution: Solution, joint: int, rows: Array) -> PartialRegression:
        """The regression about the values of a solution.

        Args:
            solution: The present terms of all joints.
            joint: The joint that a new column acts on.
            rows: Its columns, then the residual of the solution, shape (d + 1, M).
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
            others=(
                np.array([block_diag(x, np.zeros((2, 2))) for x in A]),
                np.pad(b, ((0, 0), (0, 2))),
            ),
            support=np.append(self.support, [size, size + 1]),
            columns=np.concatenate([self.columns, wave]),
            residual=self.residual - self._fitted(wave)[0] @ wave,
        )

    def _fitted(self, wave: Array) -> tuple[Array, Array, Array, Array]:
        """Gains of a pair of columns with all other terms fitted again.

        Returns:
            Gains, shape (2,), the pair orthogonalised to the other columns, shape
            (2, M), the normal matrix of the gains, and the residual, shape (M,).
        """
        S, theta, coupling = self._alone
        projection = wave @ self.columns.T @ S
        orthogonal = wave - projection @ self.columns
        H = orthogonal @ wave.T + _ridge(wave @ wave.T)
        before = self.residual - theta @ self.columns
        gains: Array = np.asarray(
            np.linalg.solve(H, orthogonal @ before - projection @ coupling)
        )
        return gains, orthogonal, H, before - gains @ orthogonal

    @cached_property
    def _alone(self) -> tuple[Array, Array, Array]:
        D, y = self.columns, self.residual
        return self._inverse(np.ones(len(self.others[0])), D @ D.T, D @ y)

    def _inverse(self, chosen: Array, P: Array, h: Array) -> tuple[Array, Array, Array]:
        """The regression without new columns.

        Args:
            chosen: One for each fold of the other joints to use, else zero, shape (F,).
            P: Normal matrix of this joint's columns, shape (d, d).
            h: Its right side, shape (d,).

        Returns:
            Inverse normal matrix and optimum of this joint's unknowns, and the gradient
            of the other joints there.
        """
        A, b = (np.tensordot(chosen, x, axes=1) for x in self.others)
        normal, moment = A.copy(), b.copy()
        normal[np.ix_(self.support, self.support)] += P
        moment[self.support] += h
        unit = np.eye(len(b))[:, self.support]
        found = pseudo_solve(normal, np.column_stack([unit, moment]))
        inverse, theta = found[self.support, :-1], found[:, -1]
        return inverse, theta[self.support], (b - A @ theta)[self.support]

    def cross_validated(
        self, waves: Array, fold: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Squared residuals on each fold by a fit on the other folds.

        Args:
            waves: Pairs of columns, shape (K, 2, M).
            fold: Fold of each sample, shape (M,).

        Returns:
            Squares without a new pair, shape (F,), and with each, shape (K, F),
            [N²·m²].
        """
        folds = len(self.others[0])
        parts = [
            _Sums.of(waves, self.columns, self.residual, fold == k)
            for k in range(folds)
        ]
        whole = [sum(x) for x in zip(*(vars(p).values() for p in parts), strict=True)]
        before, after = [], []
        for k, held in enumerate(parts):
            pairs = zip(whole, vars(held).values(), strict=True)
            B, G, c, P, h, _ = (x - y for x, y in pairs)
            S, theta, _ = self._inverse(1.0 * (np.arange(folds) != k), P, h)
            SB = S @ B.transpose(0, 2, 1)  # (K, d, 2)
            H = G - B @ SB + _ridge(G)
            gains = np.linalg.solve(H, (c - B @ theta)[..., None])
            before.append(held.squares(theta, np.zeros(2))[0])
            after.append(held.squares(theta - (SB @ gains)[..., 0], gains[..., 0]))
        return np.array(before), np.stack(after, axis=1)

    def is_significant(
        self, wave: Array, block: NDArray[np.intp], chance: float
    ) -> bool:
        """F-test: whether the gains of a pair of columns differ from zero.

        Args:
            wave: Pair of columns, shape (2, M).
            block: Block of each sample, shape (M,); noise may be correlated within one.
            chance: Probability that noise alone passes.
        """
        gains, orthogonal, H, rest = self._fitted(wave)
        _, label = np.unique(block, return_inverse=True)
        scores = np.array([np.bincount(label, weights=x * rest) for x in orthogonal])
        count = scores.shape[1]
        covariance = scores @ scores.T * count / max(count - 1, 1)
        if np.linalg.matrix_rank(covariance, hermitian=True) < len(covariance):
            return False  # too few blocks, or collinear with the other terms
        ratio = (H @ gains) @ np.linalg.solve(covariance, H @ gains) / 2
        return bool(ratio > fdtri(2, max(count - 2, 1), 1 - chance))


@dataclass(frozen=True)
class _Sums:
    """Cross-products of pairs w, columns D and residual y on some samples."""

    B: Array  # w Dᵀ, shape (K, 2, d)
    G: Array  # w wᵀ, shape (K, 2, 2)
    c: Array  # w y, shape (K, 2)
    P: Array  # D Dᵀ, shape (d, d)
    h: Array  # D y, shape (d,)
    power: float  # y y

    @classmethod
    def of(cls, waves: Array, D: Array, y: Array, use: NDArray[np.bool_]) -> _Sums:
        w, D, y = waves[:, :, use], D[:, use], y[use]
        B = (w.reshape(2 * len(w), len(y)) @ D.T).reshape(*w.shape[:2], len(D))
        G, c = w @ w.transpose(0, 2, 1), w @ y
        return cls(B, G, c, D @ D.T, D @ y, float(y @ y))

    def squares(self, theta: Array, gains: Array) -> Array:
        """Squared residuals of terms (K or 1, d) and gains (K or 1, 2)."""
        theta, gains = np.atleast_2d(theta), np.atleast_2d(gains)
        residual = (
            self.power - 2 * (theta @ self.h) + ((theta @ self.P) * theta).sum(axis=1)
        )
        wave = -2 * self.c + 2 * (self.B @ theta[:, :, None])[..., 0]
        wave = wave + (self.G @ gains[:, :, None])[..., 0]
        return np.asarray(residual + (wave * gains).sum(axis=1))


def _ridge(G: Array) -> Array:
    """A small multiple of the power, which keeps collinear pairs solvable."""
    power = np.trace(G, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray((1e-6 * power + 1e-12) * np.eye(2))
