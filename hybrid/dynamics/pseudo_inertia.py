"""Pseudo-inertia: the second moment of a link's mass in homogeneous coordinates.

J = ∫ (x, 1)(x, 1)ᵀ dm is linear in the ten parameters, and positive semidefinite if and
only if some distribution of mass has them.

Source: Wensing, Kim and Slotine 2018, doi 10.1109/LRA.2017.2729659.
"""

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.robot.chain import Chain
from hybrid.robot.spatial import INERTIA

_ROWS, _COLUMNS = np.tril_indices(4)[::-1]  # upper triangle, column by column
_STACKING = np.where(_ROWS == _COLUMNS, 1.0, np.sqrt(2.0))  # keeps the inner product
# Negative eigenvalue of a pseudo-inertia whose mass and tr(Σ) are one.
_ROUNDING = 1e-12
_DENSITY = 1000.0  # kg/m³, of a link without a mass in its file
_LEAST_WIDTH = 0.05  # of the usual width, for a link as thin as a rod


def pseudo_inertia(inertial: Array) -> Array:
    """Pseudo-inertia [[Σ, m c], [(m c)ᵀ, m]], with Σ = ½ tr(I)·1 − I.

    Parameters in the order of :data:`~hybrid.robot.chain.INERTIAL_NAMES`, shape
    (..., 10), become matrices, shape (..., 4, 4), in [kg·m²], [kg·m] and [kg].
    """
    inertial = np.asarray(inertial, dtype=float)
    about = inertial[..., INERTIA]
    J = np.empty((*inertial.shape[:-1], 4, 4))
    J[..., :3, :3] = _trace(about) / 2 * np.eye(3) - about
    J[..., :3, 3] = J[..., 3, :3] = inertial[..., 1:4]
    J[..., 3, 3] = inertial[..., 0]
    return J


def inertial_from_pseudo(J: Array) -> Array:
    """Inverse of :func:`pseudo_inertia`: shape (..., 4, 4) to (..., 10)."""
    second = J[..., :3, :3]
    about = _trace(second) * np.eye(3) - second
    rows, columns = np.tril_indices(3)
    return np.concatenate([J[..., 3, 3:], J[..., 3, :3], about[..., rows, columns]], -1)


def _trace(matrix: Array) -> Array:
    return np.asarray(np.trace(matrix, axis1=-2, axis2=-1))[..., None, None]


def is_consistent(inertial: Array) -> Mask:
    """Whether each link, shape (..., 10), is physically consistent, shape (...).

    Point masses and rods, which have no width in some direction, are consistent.
    """
    J = pseudo_inertia(inertial)
    unit = np.diagonal(J, axis1=-2, axis2=-1).copy()
    unit[..., :3] = unit[..., :3].sum(axis=-1, keepdims=True)
    unit = np.where(unit == 0, 1.0, np.sqrt(np.abs(unit)))
    smallest = np.linalg.eigvalsh(J / unit[..., None] / unit[..., None, :])[..., 0]
    return np.asarray((smallest >= -_ROUNDING) & (J[..., 3, 3] > 0))


def stacked(J: Array) -> Array:
    """Symmetric matrices as vectors, shape (..., 4, 4) to (..., 10).

    The upper triangle column by column, with off-diagonal entries times √2, as conic
    solvers need it.
    """
    return np.asarray(J[..., _ROWS, _COLUMNS] * _STACKING)


def unstacked(x: Array) -> Array:
    """Inverse of :func:`stacked`, shape (..., 10) to (..., 4, 4)."""
    J = np.empty((*x.shape[:-1], 4, 4))
    J[..., _ROWS, _COLUMNS] = J[..., _COLUMNS, _ROWS] = x / _STACKING
    return J


def inertial_per_stacked(root: Array) -> Array:
    """Derivative of ten parameters by a stacked X, J = root·X·rootᵀ, shape (10, 10)."""
    return inertial_from_pseudo(root @ unstacked(np.eye(10)) @ root.T).T


def nominal_bodies(chain: Chain, inertial: Array) -> Array:
    """Pseudo-inertia of plausible links, positive definite, shape (n, 4, 4).

    A link that is not physically consistent becomes a body as wide as a quarter of its
    length, about its centre of mass. Without a mass, it has the density of water and
    lies half-way to the next joint. Links as thin as a rod get some width.
    """
    ahead = np.vstack([chain.translation[1:], np.zeros(3)])
    length = np.linalg.norm(ahead, axis=1)
    # The axes of a wrist may meet in one point, but its links have a length.
    length = np.maximum(length, 0.3 * length.sum() if length.any() else 0.3)
    J = pseudo_inertia(inertial)
    for body, vector, width in zip(J, ahead, length / 4, strict=True):
        known = body[3, 3] > 0
        mass = body[3, 3] if known else _DENSITY * width**3
        center = body[:3, 3] / mass if known else vector / 2
        variance, axes = np.linalg.eigh(body[:3, :3] / mass - np.outer(center, center))
        if not known or variance[0] < (1e-3 * width) ** 2:
            variance = np.full(3, width**2)
        variance = np.maximum(variance, (_LEAST_WIDTH * width) ** 2)
        point = np.append(center, 1.0)
        body[...] = mass * np.outer(point, point)
        body[:3, :3] += mass * (axes * variance) @ axes.T
    return J
