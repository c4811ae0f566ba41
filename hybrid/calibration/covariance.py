"""Covariance of estimates whose measurements share the errors of their pose.

Points seen in one pose share what is wrong with it: the joints' positions, how the arm
bends and what its geometry leaves out. Poses are independent, measurements within one
need not be. With Q = J (JᵀJ)^½⁻¹ and the residuals r of each pose g,

    cov = (JᵀJ)^-½ [Σ_g Q_gᵀ (I − Q_g Q_gᵀ)^-½ r_g r_gᵀ (I − Q_g Q_gᵀ)^-½ Q_g] (JᵀJ)^-½

which has no bias where all noise is alike and independent (CR2). Its own spread is that
of a χ² with Satterthwaite's degrees of freedom. Bell & McCaffrey 2002; Imbens & Kolesár
2016, doi 10.1162/REST_a_00552.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from hybrid.arrays import Array

_ALONE = 1e-9  # share of a measurement's noise that reaches its residual


def clustered_covariance(
    jacobian: Array, residual: Array, pose: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Covariance of least-squares estimates, and the degrees of freedom of each.

    What one pose alone tells leaves no residual there; it has the noise of its kind.

    Args:
        jacobian: Derivatives over noise, shape (rows, b), of full rank; rows > b.
        residual: Residuals over noise, shape (rows,).
        pose: Pose of each row, shape (rows,).

    Returns:
        Covariance, shape (b, b), and degrees of freedom of each variance, shape (b,).
    """
    rows, size = jacobian.shape
    Q, R = np.linalg.qr(jacobian)
    way = solve_triangular(R, np.eye(size))  # (b, b): from Q's unknowns to ours
    inner = np.zeros((size, size))
    alone, lengths, shares = np.zeros(size), [], []
    for g in np.unique(pose):
        here = Q[pose == g]  # (rows of the pose, b)
        free, axes = np.linalg.eigh(np.eye(len(here)) - here @ here.T)
        seen = free > _ALONE
        untold = here.T @ axes[:, ~seen]
        inverse = axes[:, seen] / np.sqrt(free[seen]) @ axes[:, seen].T
        told = here.T @ inverse  # (b, rows of the pose)
        score = told @ residual[pose == g]
        inner += np.outer(score, score) + untold @ untold.T
        alone += ((way @ untold) ** 2).sum(axis=1)
        lengths.append(((way @ told) ** 2).sum(axis=1))
        shares.append(way @ told @ here)
    # Under independent noise a variance is a quadratic form in it: diag(length) − S Sᵀ
    # over the poses, whose trace is the variance (but for what is told alone).
    length, share = np.array(lengths), np.array(shares)  # (G, b), (G, b, b)
    both = np.einsum("gkm,hkm->kgh", share, share)
    square = (both**2).sum(axis=(1, 2)) + (length**2).sum(axis=0)
    square -= 2 * (length * np.einsum("gkm,gkm->gk", share, share)).sum(axis=0)
    whole = (way**2).sum(axis=1)
    return way @ inner @ way.T, whole**2 / (square + alone**2 / (rows - size))
