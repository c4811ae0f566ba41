"""Nearest point of a product of semidefinite cones and half-lines, by Clarabel.

Source: Goulart and Chen 2024, arXiv 2405.12762 (interior-point conic solver).
"""

import numpy as np
from scipy.sparse import csc_matrix

from hybrid.arrays import Array
from hybrid.dynamics.pseudo_inertia import stacked, unstacked
from hybrid.errors import IdentificationError

_SCALES = (1e8, 1e5, 1e2)  # of the objective; the first nearly always succeeds
_SETTINGS = {
    "verbose": False,
    "equilibrate_enable": False,  # the coordinates are scaled already
    "static_regularization_constant": 1e-10,
    "tol_gap_abs": 1e-11,
    "tol_gap_rel": 1e-10,
    "tol_infeas_abs": 1e-14,  # heavy links are always feasible
    "tol_infeas_rel": 1e-14,
}


def nearest_above(
    target: Array, metric: Array, least: Array, n: int
) -> tuple[Array, bool]:
    """The point z nearest to ``target`` that is above ``least``.

    The first 10n coordinates are n stacked 4×4 matrices, which are bounded in their
    eigenvalues; the others are numbers.

    Args:
        target: The point to approach, shape (z,).
        metric: Positive definite metric, shape (z, z).
        least: Multiples of the unit matrix, then numbers (−inf for none), shape (z,).
        n: Number of matrices.

    Returns:
        The point, and whether the solver reached its accuracy.

    Raises:
        IdentificationError: The solver failed.
    """
    import clarabel

    bounded = np.isfinite(least)
    cones = [clarabel.PSDTriangleConeT(4)] * n
    cones += [clarabel.NonnegativeConeT(int(bounded[10 * n :].sum()))]
    settings = clarabel.DefaultSettings()
    for name, value in _SETTINGS.items():
        setattr(settings, name, value)
    approximate = None
    for scale in _SCALES:
        solution = clarabel.DefaultSolver(
            csc_matrix(np.triu(scale * metric)),
            np.zeros(len(target)),
            csc_matrix(-np.eye(len(target))[bounded]),
            (target - least)[bounded],
            cones,
            settings,
        ).solve()
        status = str(solution.status)
        if status == "Solved":
            return _clipped(target + np.array(solution.x), least, n), True
        if status == "AlmostSolved" and approximate is None:
            approximate = target + np.array(solution.x)
    if approximate is not None:
        return _clipped(approximate, least, n), False
    raise IdentificationError(
        f"no physically consistent links were found (Clarabel: {status}); more or "
        "richer motion, or a better nominal robot file, is needed"
    )


def _clipped(z: Array, least: Array, n: int) -> Array:
    """Clip what is below ``least`` by a rounding error."""
    values, vectors = np.linalg.eigh(unstacked(z[: 10 * n].reshape(n, 10)))
    values = np.maximum(values, least[: 10 * n : 10, None])
    matrices = (vectors * values[:, None]) @ vectors.transpose(0, 2, 1)
    return np.append(stacked(matrices), np.maximum(z[10 * n :], least[10 * n :]))
