"""Observability of the parameters of a calibration in a set of poses."""

import numpy as np

from hybrid.arrays import Array


def observability_index(jacobian: Array, poses: int) -> float:
    """Index O₁: geometric mean of the singular values over the root of the poses.

    Borm and Menq 1991, doi 10.1177/027836499101000106. A larger index means a smaller
    volume of the confidence region.

    Args:
        jacobian: Derivatives over noise, shape (rows, b).
        poses: Number of poses N.
    """
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    if sizes[-1] <= 0:
        return 0.0
    return float(np.exp(np.log(sizes).mean()) / np.sqrt(poses))
