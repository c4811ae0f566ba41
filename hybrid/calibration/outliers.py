"""Outlier test of each measurement against the prediction by the others.

With many parameters, a fit follows each measurement, so its residual is small. The test
uses the prediction by the other measurements. The covariance of a residual is S = I − H
for a fitted unit, and S = I + H for one left out. rᵀS⁻¹r has a beta distribution in the
first case and an F distribution in the second, and the result is the same in both
(deletion residuals: Cook & Weisberg 1982, ch. 2.2; a set of inliers that grows by them:
Hadi 1992, doi 10.1111/j.2517-6161.1992.tb01449.x).
"""

import numpy as np
from scipy.special import betainccinv, fdtri

from hybrid.arrays import Array, Mask

OUTSIDE = 5e-4  # probability that a good measurement is rejected
_SINGULAR = 1e-9  # share of the noise in a residual that counts as zero


def misfit(
    residual: Array,
    jacobian: Array,
    inverse: Array,
    kept: Mask,
    freedom: float,
) -> Array:
    """Size of each unit's residual over the bound of the outlier test, shape (U,).

    Residuals, shape (U, c), and derivatives, (U, c, b), are over noise, whose estimate
    has some degrees of freedom. ``inverse`` is the covariance of the estimates from the
    kept units, shape (b, b).
    """
    size = residual.shape[1]
    H = jacobian @ inverse @ jacobian.swapaxes(1, 2)  # (U, c, c)
    S = np.eye(size) + np.where(kept, -1.0, 1.0)[:, None, None] * H
    free, axes = np.linalg.eigh(S)
    along = np.einsum("uij,ui->uj", axes, residual) ** 2
    square = (along / np.maximum(free, _SINGULAR)).sum(axis=1)
    rest = max(freedom - size, 1.0)
    inner = freedom * float(betainccinv(size / 2, rest / 2, OUTSIDE))
    outer = size * float(fdtri(size, max(freedom, 1.0), 1 - OUTSIDE))
    return np.asarray(np.sqrt(square / np.where(kept, inner, outer)))
