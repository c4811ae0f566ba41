"""Rotations and inertias of rigid bodies, for readers and writers of robot files."""

import numpy as np

from hybrid.arrays import Array

# Places of the inertia matrix in the ten inertial parameters of a link.
INERTIA = np.array([[4, 5, 7], [5, 6, 8], [7, 8, 9]])
ROUNDED = 1.5e-5  # of a moment of inertia: rounding error of three six-digit numbers
_SMALLEST = 1e-9  # kg·m²; rounding of smaller moments is ignored


def skew(x: Array) -> Array:
    """Matrix of the cross product, ``skew(x) @ y == cross(x, y)``, shape (3, 3)."""
    return np.array(
        [[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]], dtype=np.float64
    )


def inertial_about(mass: float, center: Array, inertia: Array) -> Array:
    """Ten inertial parameters of a body about the frame origin.

    They are (m, m·c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz); the argument is the inertia about
    the centre of mass, shape (3, 3), [kg·m²].
    """
    k = skew(center)
    about = inertia - mass * (k @ k)
    return np.array([mass, *(mass * center), *about[np.tril_indices(3)]])


def central_inertia(inertial: Array) -> tuple[float, Array, Array]:
    """Mass, centre of mass and central inertia from ten parameters.

    A massless link has its centre at the frame origin.

    Returns:
        Mass [kg], centre shape (3,) [m], inertia about it shape (3, 3) [kg·m²].
    """
    mass = float(inertial[0])
    center = inertial[1:4] / mass if mass > 0 else np.zeros(3)
    k = skew(center)
    return mass, center, inertial[INERTIA] + mass * (k @ k)


def inertia_fault(mass: float, about: Array) -> str:
    """Say why mass and inertia about its centre are not physical; empty if they are."""
    size, moments = np.abs(about).max(), np.full(3, np.nan)
    if 0 <= size < np.inf:
        moments = np.linalg.eigvalsh(about / (size or 1.0)) * size
    least = min(moments[0], moments[0] + moments[1] - moments[2])
    if mass >= 0 and least >= -ROUNDED * max(moments[2], _SMALLEST):
        return ""
    return (
        f"has no physical inertia (mass {mass:g} kg, moments "
        f"{', '.join(f'{x:.4g}' for x in moments)} kg·m²); valid are a mass of 0 or "
        "more and moments of which none is above the sum of the others"
    )


def link_spread(inertial: Array) -> Array:
    """Scale of each link parameter, for relative errors, shape (n, 10).

    A coordinate of the centre of mass that is zero in the file may still be wrong. The
    scale is therefore the same in all directions: the distance of the centre of mass
    from the origin, at least a third of the link's radius of gyration.
    """
    scale = np.zeros_like(inertial)
    for k in np.flatnonzero(inertial[:, 0] > 0):
        mass, center, about = central_inertia(inertial[k])
        own = np.trace(about) / 2
        radius = np.sqrt(max(own / mass, 1e-8))
        scale[k, 0] = mass
        scale[k, 1:4] = mass * max(float(np.linalg.norm(center)), radius / 3)
        scale[k, 4:] = own / 2 + mass * (center @ center) + 1e-9
    return scale
