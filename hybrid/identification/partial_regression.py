"""Test whether one more term of a joint lowers the error beside the others.

A new column may look much like a sum of others, a slow ripple like gravity. Its gain
and its worth are those that remain once all other terms, at all joints, have been
fitted anew; that takes cross-products only, however many columns are tried.

Source: Frisch and Waugh 1933, doi 10.2307/1907330; Liang and Zeger 1986,
doi 10.1093/biomet/73.1.13 (noise that is alike within blocks).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.special import fdtri

from hybrid.arrays import Array
from hybrid.identification.solution import Solution
from hybrid.regression.least_squares import pseudo_inverse


@dataclass(frozen=True)
class PartialRegression:
    """New columns of one joint, judged with all other terms fitted anew around them.

    Attributes:
        others: Normal matrix and right side of the other joints on each fold, shapes
            (F, p, p) and (F, p), in units of this joint's variance.
        support: Unknowns that move this joint, shape (d,).
        columns: Their columns, shape (d, M).
        left: What the present values leave, shape (M,), [N·m].
    """

    others: tuple[Array, Array]
    support: NDArray[np.intp]
    columns: Array
    left: Array

    @classmethod
    def of(cls, solution: Solution, joint: int, rows: Array) -> PartialRegression:
        """All terms of a solution.

        Args:
            solution: The terms so far, on all joints.
            joint: The joint that a new column acts on.
            rows: Its columns, and what the solution leaves of its torque last,
                shape (d + 1, M).
        """
        products, theta = solution.products, solution.settled.theta
        variance = np.diag(solution.sigma)
        weight = np.diag(variance[joint] / np.maximum(variance, 1e-300))
        weight[joint, joint] = 0.0
        A, b = [], []
        for sums in products.folds:
            A_k, b_k = products.normal(weight, sums)
            A.append(A_k)
            b.append(b_k - A_k @ theta)
        support = solution.problem.support[joint]
        return cls((np.array(A), np.array(b)), support, rows[:-1], rows[-1])

    def with_wave(self, wave: Array) -> PartialRegression:
        """The same with a wave, shape (2, M), at its best gains among the terms."""
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
            left=self.left - self._gains(wave)[0] @ wave,
        )

    def _gains(self, wave: Array) -> tuple[Array, Array, Array, Array]:
        """Gains of a wave, its own part, its normal matrix, and what it leaves."""
        S, theta, asked = self._inverse(
            np.ones(len(self.others[0]), dtype=bool), self.columns, self.left
        )
        alike = wave @ self.columns.T @ S
        own = wave - alike @ self.columns
        H = own @ wave.T + _ridge(wave @ wave.T)
        before = self.left - theta @ self.columns
        gains: Array = np.asarray(np.linalg.solve(H, own @ before - alike @ asked))
        return gains, own, H, before - gains @ own

    def _inverse(
        self, chosen: NDArray[np.bool_], D: Array, y: Array
    ) -> tuple[Array, Array, Array]:
        """Of its unknowns, without a wave.

        Returns:
            Inverse normal matrix, optimum, and what other joints would have besides.
        """
        A, b = (x[chosen].sum(axis=0) for x in self.others)
        here = np.ix_(self.support, self.support)
        whole, moment = A.copy(), b.copy()
        whole[here] += D @ D.T
        moment[self.support] += D @ y
        inverse = pseudo_inverse(whole)
        theta = inverse @ moment
        asked = (b - A @ theta)[self.support]
        return inverse[here], theta[self.support], asked

    def cross_validated(
        self, waves: Array, fold: NDArray[np.intp]
    ) -> tuple[Array, Array]:
        """Squares on each fold by terms from the others.

        Args:
            waves: Pairs of columns, shape (K, 2, M).
            fold: Fold of each sample, shape (M,).

        Returns:
            Squares without a wave, shape (F,), and with each, shape (K, F), [N²·m²].
        """
        folds = len(self.others[0])
        parts = [
            _Sums.of(waves, self.columns, self.left, fold == k) for k in range(folds)
        ]
        before, after = [], []
        for k, held in enumerate(parts):
            rest = fold != k
            S, theta, _ = self._inverse(
                np.arange(folds) != k, self.columns[:, rest], self.left[rest]
            )
            B, G, c = (
                sum(getattr(x, name) for x in parts) - getattr(held, name)
                for name in ("B", "G", "c")
            )
            SB = S @ B.transpose(0, 2, 1)  # (K, d, 2)
            H = G - B @ SB + _ridge(G)
            gains = np.linalg.solve(H, (c - B @ theta)[..., None])
            before.append(held.squares(theta, np.zeros(2))[0])
            after.append(held.squares(theta - (SB @ gains)[..., 0], gains[..., 0]))
        return np.array(before), np.stack(after, axis=1)

    def shows(self, wave: Array, block: NDArray[np.intp], chance: float) -> bool:
        """Whether the gains of a wave differ from zero by more than noise makes them.

        Args:
            wave: Pair of columns, shape (2, M).
            block: Block of each sample; noise may be alike within, shape (M,).
            chance: How often noise alone may pass.
        """
        gains, own, H, rest = self._gains(wave)
        _, label = np.unique(block, return_inverse=True)
        scores = np.array([np.bincount(label, weights=x * rest) for x in own])
        count = scores.shape[1]
        spread = scores @ scores.T * count / max(count - 1, 1)
        if np.linalg.matrix_rank(spread, hermitian=True) < len(spread):
            return False  # too few blocks, or the other terms explain the wave whole
        ratio = (H @ gains) @ np.linalg.solve(spread, H @ gains) / 2
        allowed = fdtri(2, max(count - 2, 1), 1 - chance)
        return bool(ratio > allowed)


@dataclass(frozen=True)
class _Sums:
    """Cross-products on some samples of waves w, columns D and what is left y."""

    B: Array  # w Dᵀ, shape (K, 2, d)
    G: Array  # w wᵀ, shape (K, 2, 2)
    c: Array  # w y, shape (K, 2)
    P: Array  # D Dᵀ, shape (d, d)
    h: Array  # D y, shape (d,)
    power: float  # y y

    @classmethod
    def of(cls, waves: Array, D: Array, y: Array, use: NDArray[np.bool_]) -> _Sums:
        w, D, y = waves[:, :, use].astype(float), D[:, use], y[use]
        flat = w.reshape(-1, w.shape[2])
        B = (flat @ D.T).reshape(*w.shape[:2], len(D))
        G, c = w @ w.transpose(0, 2, 1), w @ y
        return cls(B, G, c, D @ D.T, D @ y, float(y @ y))

    def squares(self, theta: Array, gains: Array) -> Array:
        """Sum of squares that terms (K or 1, d) and gains (K or 1, 2) leave."""
        theta, gains = np.atleast_2d(theta), np.atleast_2d(gains)
        left = (
            self.power - 2 * (theta @ self.h) + ((theta @ self.P) * theta).sum(axis=1)
        )
        wave = -2 * self.c + 2 * (self.B @ theta[:, :, None])[..., 0]
        wave = wave + (self.G @ gains[:, :, None])[..., 0]
        return np.asarray(left + (wave * gains).sum(axis=1))


def _ridge(G: Array) -> Array:
    """A trace of the waves' power, for those that the other terms explain whole."""
    power = np.trace(G, axis1=-2, axis2=-1)[..., None, None]
    return np.asarray((1e-6 * power + 1e-12) * np.eye(2))
