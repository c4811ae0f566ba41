"""Batched motion of every link of a chain, from base to tip.

In arrays the component comes first and the sample last, so that operations run over
contiguous samples.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.robot.chain import Chain
from hybrid.robot.spatial import skew

_ROUNDING = 1e-15  # entry of a rotation that counts as zero


@dataclass(frozen=True)
class LinkMotion:
    """Motion of one link in its own frame, and the joints that move it.

    Attributes:
        omega: Angular velocity, shape (3, N), [rad/s].
        alpha: Angular acceleration, shape (3, N), [rad/s²].
        accel: Acceleration of the frame origin less gravity, shape (3, N), [m/s²].
        angular: Axis of each joint up to this one, shape (3, k+1, N); the angular
            velocity of this link per unit of joint speed.
        linear: Velocity of this frame's origin per unit of joint speed, (3, k+1, N).
    """

    omega: Array
    alpha: Array
    accel: Array
    angular: Array
    linear: Array


def link_motions(chain: Chain, q: Array, v: Array, a: Array) -> Iterator[LinkMotion]:
    """Motion of each link, base to tip.

    Args:
        chain: The arm.
        q: Positions, shape (n, N), [rad].
        v: Speeds, shape (n, N), [rad/s].
        a: Accelerations, shape (n, N), [rad/s²].
    """
    n, samples = q.shape
    # Rows 0..2 are ω, α and the acceleration; then the joint screws (angular, linear).
    state = np.zeros((3, 3, samples))
    state[:, 2] = -chain.gravity[:, None]
    for k in range(n):
        axis = chain.axis[k]
        moved = np.empty((3, 5 + 2 * k, samples))
        moved[:, : 3 + 2 * k] = _shift_and_turn(chain, k, q[k], state)
        omega, alpha, accel = moved[:, 0], moved[:, 1], moved[:, 2]
        turning = 1.0 if chain.revolute[k] else 0.0
        for c in range(3):
            moved[c, 3 + 2 * k] = turning * axis[c]
            moved[c, 4 + 2 * k] = (1.0 - turning) * axis[c]
        # ω×axis is the same before and after the joint's own speed is added.
        spin = cross(omega, axis)
        if chain.revolute[k]:
            alpha += spin * v[k] + axis[:, None] * a[k]
            omega += axis[:, None] * v[k]
        else:
            accel += 2.0 * spin * v[k] + axis[:, None] * a[k]
        state = moved
        yield LinkMotion(omega, alpha, accel, state[:, 3::2], state[:, 4::2])


def _shift_and_turn(chain: Chain, k: int, q: Array, state: Array) -> Array:
    """Move parent quantities to the origin of frame k and express them in it."""
    shifted = state.copy()
    offset = chain.translation[k]
    if chain.revolute[k]:
        arm: list[Array | float] = list(offset)
    else:
        direction = chain.rotation[k] @ chain.axis[k]
        arm = [offset[c] + direction[c] * q for c in range(3)]
    omega, alpha = state[:, 0], state[:, 1]
    if not chain.revolute[k] or np.any(offset):
        lever = cross(omega, arm)
        shifted[:, 2] += cross(alpha, arm) + cross(omega, lever)
        shifted[:, 4::2] += cross(state[:, 3::2], arm)
    return _turn(chain, k, q, shifted)


def _turn(chain: Chain, k: int, q: Array, x: Array) -> Array:
    """R(q)ᵀ x without the zeros of R; x has shape (3, K, N)."""
    parts = tuple(
        zip(rotation_terms(chain, k), (1.0, np.sin(q), np.cos(q)), strict=True)
    )
    out = np.zeros_like(x)
    for c in range(3):
        for r in range(3):
            entry = [A[r, c] * part for A, part in parts if A[r, c] != 0]
            if entry:
                out[c] += sum(entry[1:], entry[0]) * x[r]
    return out


def frames(chain: Chain, q: Array) -> tuple[Array, Array, Array]:
    """Orientation, origin and joint axis of each link in the base frame.

    Args:
        chain: The arm.
        q: Positions, shape (N, n), [rad].

    Returns:
        Shapes (n, N, 3, 3), (n, N, 3) and (n, N, 3).
    """
    from scipy.spatial.transform import Rotation

    count = len(q)
    R, p = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    out: tuple[list[Array], list[Array], list[Array]] = ([], [], [])
    for k in range(chain.size):
        p = p + R @ chain.translation[k]
        R = R @ chain.rotation[k]
        axis = R @ chain.axis[k]
        if chain.revolute[k]:
            R = R @ Rotation.from_rotvec(q[:, k, None] * chain.axis[k]).as_matrix()
        else:
            p = p + axis * q[:, k, None]
        for items, x in zip(out, (R, p, axis), strict=True):
            items.append(x)
    return np.stack(out[0]), np.stack(out[1]), np.stack(out[2])


def rotation_terms(chain: Chain, k: int) -> tuple[Array, Array, Array]:
    """Matrices A, B and C, shape (3, 3) each, with R(q) = A + B·sin q + C·cos q.

    R turns the frame of link k to its parent's. Entries that are rounding errors of the
    file's angles are zero.
    """
    fixed = chain.rotation[k]
    turn = skew(chain.axis[k]) if chain.revolute[k] else np.zeros((3, 3))
    matrices = (np.eye(3) + turn @ turn, turn, -turn @ turn)
    constant, sine, cosine = (without_rounding(fixed @ x) for x in matrices)
    return constant, sine, cosine


def without_rounding(matrix: Array) -> Array:
    """A matrix in which entries of rounding size are zero."""
    return np.where(np.abs(matrix) < _ROUNDING, 0.0, matrix)


def cross(x: Array, y: Sequence[Array | float] | Array) -> Array:
    """Cross product over the first axis; y may hold numbers."""
    return np.stack(
        [
            x[1] * y[2] - x[2] * y[1],
            x[2] * y[0] - x[0] * y[2],
            x[0] * y[1] - x[1] * y[0],
        ]
    )
