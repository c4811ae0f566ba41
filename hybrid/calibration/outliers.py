"""Test how badly each measurement fits the others.

Where parameters are many, a fit bends towards each measurement, so that its residual
says little. The rule is that of prediction: with S = I − H the covariance of a fitted
unit's residual, and S = I + H that of one left out, rᵀS⁻¹r follows the distributions of
beta and of Fisher, and the verdict is the same whether the unit was fitted or left out
(deletion residuals: Cook & Weisberg 1982, ch. 2.2; a kept set that grows by them: Hadi
1992, doi 10.1111/j.2517-6161.1992.tb01449.x).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta
from scipy.stats import f as fisher

from hybrid.arrays import Array

OUTSIDE = 5e-4  # share of good measurements that the rejection costs
_SINGULAR = 1e-9  # of the noise: what a unit alone tells leaves no residual


def misfit(
    residual: Array,
    jacobian: Array,
    inverse: Array,
    kept: NDArray[np.bool_],
    freedom: float,
) -> Array:
    """Size of each unit over the largest that chance gives it, shape (U,).

    Args:
        residual: Over noise, shape (U, c).
        jacobian: Derivatives over noise, shape (U, c, b).
        inverse: Covariance of the estimates from what is kept, shape (b, b).
        kept: What the estimates are fitted to, shape (U,).
        freedom: Degrees of freedom that the noise was estimated with.
    """
    size = residual.shape[1]
    H = jacobian @ inverse @ jacobian.swapaxes(1, 2)  # (U, c, c)
    S = np.eye(size) + np.where(kept, -1.0, 1.0)[:, None, None] * H
    free, axes = np.linalg.eigh(S)
    along = np.einsum("uij,ui->uj", axes, residual) ** 2
    square = (along / np.maximum(free, _SINGULAR)).sum(axis=1)
    rest = max(freedom - size, 1.0)
    inner = freedom * float(beta.isf(OUTSIDE, size / 2, rest / 2))
    outer = size * float(fisher.isf(OUTSIDE, size, max(freedom, 1.0)))
    return np.asarray(np.sqrt(square / np.where(kept, inner, outer)))
