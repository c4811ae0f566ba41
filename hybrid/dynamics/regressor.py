"""Batched inverse dynamics and its regressor: tau = Y(q, v, a) · pi.

Source: Atkeson, An and Hollerbach 1986, doi 10.1177/027836498600500306.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.kinematics import LinkMotion, link_motions
from hybrid.dynamics.newton_euler import rigid_law
from hybrid.robot.chain import Chain

_CHUNK = 4096  # samples at a time, whose intermediate arrays stay in the cache


def regressor(
    chain: Chain, q: Array, v: Array, a: Array, which: Sequence[int] | None = None
) -> Array:
    """Torque per unit of all inertial parameters, or of some.

    Args:
        chain: The arm.
        q: Positions, shape (N, n), [rad].
        v: Speeds, shape (N, n), [rad/s].
        a: Accelerations, shape (N, n), [rad/s²].
        which: Wanted columns out of the 10n, length c; all by default.

    Returns:
        Y, shape (N, n, c), link by link in the order of ``INERTIAL_NAMES``, or in that
        of ``which``. It is a view of an array of shape (n, c, N).
    """
    samples, n = q.shape
    wanted: list[list[tuple[int, int]]] = [[] for _ in range(n)]
    for row, column in enumerate(range(10 * n) if which is None else which):
        wanted[column // 10].append((row, column % 10))
    Y = np.zeros((n, sum(map(len, wanted)), samples))
    for start in range(0, samples, _CHUNK):
        part = slice(start, min(start + _CHUNK, samples))
        states = (np.ascontiguousarray(x[part].T) for x in (q, v, a))
        for k, link in enumerate(link_motions(chain, *states)):
            terms = _link_terms(link)
            for row, parameter in wanted[k]:
                _sum(Y[: k + 1, row, part], *terms[parameter])
    return Y.transpose(2, 0, 1)


def inverse_dynamics(
    chain: Chain, inertial: Array, q: Array, v: Array, a: Array
) -> Array:
    """Rigid-body joint torque, without rotor inertia.

    Args:
        chain: The arm.
        inertial: Link parameters, shape (n, 10).
        q: Positions, shape (N, n), [rad].
        v: Speeds, shape (N, n), [rad/s].
        a: Accelerations, shape (N, n), [rad/s²].

    Returns:
        Torque, shape (N, n), [N·m].
    """
    law = rigid_law(chain)
    constants = [*inertial.ravel().tolist(), *chain.gravity.tolist()]
    return law.along((q, v, a), constants)


def _link_terms(link: LinkMotion) -> tuple[tuple[tuple[Array, Array], ...], ...]:
    """The ten columns of one link for the joints that move it, as sums of products.

    The row of a joint with the screw s = (linear, angular) is s · (force, moment) per
    unit of each parameter. Here it is a dot product with coefficients that depend on
    the link's motion only, shapes (k+1, N) and (N,).
    """
    (wx, wy, wz), (bx, by, bz), (ax, ay, az) = link.omega, link.alpha, link.accel
    xx, yy, zz, xy, xz, yz = wx * wx, wy * wy, wz * wz, wx * wy, wx * wz, wy * wz
    lx, ly, lz = link.linear
    ux, uy, uz = link.angular
    return (
        ((lx, ax), (ly, ay), (lz, az)),
        # First moments: (skew(α) + skew(ω)²)ᵀ l + a × u.
        ((lx, -yy - zz), (ly, xy + bz), (lz, xz - by), (uz, ay), (uy, -az)),
        ((lx, xy - bz), (ly, -xx - zz), (lz, yz + bx), (ux, az), (uz, -ax)),
        ((lx, xz + by), (ly, yz - bx), (lz, -xx - yy), (uy, ax), (ux, -ay)),
        # Inertia: u · (I α) + (u × ω) · (I ω), for each independent entry of I.
        ((ux, bx), (uy, xz), (uz, -xy)),
        ((ux, by - xz), (uy, bx + yz), (uz, xx - yy)),
        ((ux, -yz), (uy, by), (uz, xy)),
        ((ux, bz + xy), (uy, zz - xx), (uz, bx - yz)),
        ((ux, yy - zz), (uy, bz - xy), (uz, by + xz)),
        ((ux, yz), (uy, -xz), (uz, bz)),
    )


def _sum(out: Array, *terms: tuple[Array, Array]) -> None:
    """Sum of products into ``out``, shape (k+1, N)."""
    (x, y), *rest = terms
    total = x * y
    for x, y in rest:
        total += x * y
    out[...] = total
