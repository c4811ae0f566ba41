"""Cluster-robust covariance of estimates; the clusters are the poses.

Measurements in one pose have common errors: of the joint positions, of deflection, and
of the geometry that is not modelled. Errors of different poses are independent. With
Q = J (JᵀJ)^½⁻¹ and the residuals r of each pose g,

    cov = (JᵀJ)^-½ [Σ_g Q_gᵀ (I − Q_g Q_gᵀ)^-½ r_g r_gᵀ (I − Q_g Q_gᵀ)^-½ Q_g] (JᵀJ)^-½

It has no bias if all noise is independent with one variance (CR2), and is distributed
as χ² with Satterthwaite's degrees of freedom. Bell & McCaffrey 2002; Imbens & Kolesár
2016, doi 10.1162/REST_a_00552.
"""

import numpy as np
from scipy.linalg import solve_triangular

from hybrid.arrays import Array, Index

_SINGULAR = 1e-9  # share of a measurement's noise in its residual that counts as zero


def clustered_covariance(
    jacobian: Array, residual: Array, pose: Index
) -> tuple[Array, Array]:
    """Covariance of estimates, (b, b), and degrees of freedom of each variance, (b,).

    A direction that one pose alone determines has no residual; it gets unit noise. Each
    row has derivatives, shape (rows, b), of full rank, and a residual, both over noise,
    and a pose.
    """
    rows, size = jacobian.shape
    Q, R = np.linalg.qr(jacobian)
    transform = solve_triangular(R, np.eye(size))  # (b, b): from Q's unknowns to ours
    inner = np.zeros((size, size))
    exact, lengths, shares = np.zeros(size), [], []
    for g in np.unique(pose):
        here = Q[pose == g]  # (rows of the pose, b)
        free, axes = np.linalg.eigh(np.eye(len(here)) - here @ here.T)
        seen = free > _SINGULAR
        exact_part = here.T @ axes[:, ~seen]
        inverse = axes[:, seen] / np.sqrt(free[seen]) @ axes[:, seen].T
        weighted = here.T @ inverse  # (b, rows of the pose)
        score = weighted @ residual[pose == g]
        inner += np.outer(score, score) + exact_part @ exact_part.T
        exact += ((transform @ exact_part) ** 2).sum(axis=1)
        lengths.append(((transform @ weighted) ** 2).sum(axis=1))
        shares.append(transform @ weighted @ here)
    # Under independent noise a variance is a quadratic form of it: diag(length) − S Sᵀ
    # over the poses, whose trace is the variance (without the directions of one pose).
    length, share = np.array(lengths), np.array(shares)  # (G, b), (G, b, b)
    products = np.einsum("gkm,hkm->kgh", share, share)
    square = (products**2).sum(axis=(1, 2)) + (length**2).sum(axis=0)
    square -= 2 * (length * np.einsum("gkm,gkm->gk", share, share)).sum(axis=0)
    variance = (transform**2).sum(axis=1)
    return transform @ inner @ transform.T, variance**2 / (
        square + exact**2 / (rows - size)
    )
