"""Gradient of any weighted sum of regressor entries, by reverse differentiation.

The weights of Y are the seed. The gradient of any function of Y costs a few evaluations
of Y, independent of the number of joints.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.dynamics.kinematics import LinkMotion, cross, link_motions
from hybrid.robot.chain import Chain

_CHUNK = 4096  # samples at a time, as in the regressor


def regressor_gradient(
    chain: Chain, q: Array, v: Array, a: Array, weight: Array
) -> tuple[Array, Array, Array]:
    """Derivatives of ``sum(weight * regressor(chain, q, v, a))`` by the motion.

    Args:
        chain: The arm.
        q: Positions, shape (N, n), [rad].
        v: Speeds, shape (N, n), [rad/s].
        a: Accelerations, shape (N, n), [rad/s²].
        weight: Weight of each entry of the regressor, shape (N, n, 10n). Entries of
            joints beyond a link have no effect.

    Returns:
        Derivatives by q, v and a, each of shape (N, n).
    """
    out = np.empty((3, *q.shape))
    for start in range(0, len(q), _CHUNK):
        part = slice(start, start + _CHUNK)
        qt, vt, at = (np.ascontiguousarray(x[part].T) for x in (q, v, a))
        P = np.ascontiguousarray(weight[part].transpose(1, 2, 0))  # (n, 10n, N)
        out[:, part] = _backward(chain, qt, vt, at, P).transpose(0, 2, 1)
    return out[0], out[1], out[2]


def torque_gradient(
    chain: Chain, q: Array, v: Array, a: Array, inertial: Array, joint: NDArray[np.intp]
) -> tuple[Array, Array, Array]:
    """Derivatives of one joint's rigid-body torque in each sample by the motion.

    Args:
        chain: The arm.
        q: Positions, shape (N, n), [rad].
        v: Speeds, shape (N, n), [rad/s].
        a: Accelerations, shape (N, n), [rad/s²].
        inertial: Link parameters, shape (n, 10).
        joint: Index of the joint in each sample, shape (N,).

    Returns:
        Derivatives by q, v and a, each of shape (N, n).
    """
    weight = np.zeros((*q.shape, inertial.size))
    weight[np.arange(len(q)), joint] = inertial.ravel()
    return regressor_gradient(chain, q, v, a, weight)


def _backward(chain: Chain, q: Array, v: Array, a: Array, P: Array) -> Array:
    """Derivatives by q, v and a, shape (3, n, N); names with _ hold derivatives."""
    links = list(link_motions(chain, q, v, a))
    out = np.zeros((3, *q.shape))
    state_ = np.zeros((3, 3 + 2 * len(links), q.shape[1]))
    for k in reversed(range(len(links))):
        link, axis = links[k], chain.axis[k]
        _add_block(link, P[: k + 1, 10 * k : 10 * k + 10], state_)
        omega_, alpha_, accel_ = state_[:, 0], state_[:, 1], state_[:, 2]
        spin = cross(link.omega, axis)
        if chain.revolute[k]:
            out[2, k] = axis @ alpha_
            out[1, k] = axis @ omega_ + _dot(spin, alpha_)
            omega_ -= cross(alpha_, axis) * v[k]
            # The joint's own part of the state lies along its axis, so only the part
            # of the parent depends on the angle.
            parent = _before_joint(link, axis, v[k], a[k], spin)
            turned_ = np.delete(state_, (3 + 2 * k, 4 + 2 * k), axis=1)
            out[0, k] = axis @ cross(turned_, parent).sum(axis=1)
        else:
            out[2, k] = axis @ accel_
            out[1, k] = 2.0 * _dot(spin, accel_)
            omega_ -= 2.0 * cross(accel_, axis) * v[k]
            turned_ = state_[:, : 3 + 2 * k]
        turned_ = _turn_back(chain, k, q[k], turned_)
        before = links[k - 1] if k else None
        state_, arm_ = _shift_back(chain, k, q[k], turned_, before)
        if not chain.revolute[k]:
            out[0, k] = (chain.rotation[k] @ axis) @ arm_
    return out


def _before_joint(
    link: LinkMotion, axis: Array, v: Array, a: Array, spin: Array
) -> Array:
    """The parent's quantities in the rotated frame, shape (3, 3 + 2k, N)."""
    k = link.angular.shape[1] - 1
    parent = np.empty((3, 3 + 2 * k, link.omega.shape[1]))
    parent[:, 0] = link.omega - axis[:, None] * v
    parent[:, 1] = link.alpha - spin * v - axis[:, None] * a
    parent[:, 2] = link.accel
    parent[:, 3::2], parent[:, 4::2] = link.angular[:, :k], link.linear[:, :k]
    return parent


def _shift_back(
    chain: Chain, k: int, q: Array, state_: Array, parent: LinkMotion | None
) -> tuple[Array, Array]:
    """Derivatives by the parent's quantities, and by the offset of frame k."""
    offset = chain.translation[k][:, None] + np.zeros_like(q)
    if not chain.revolute[k]:
        offset = offset + (chain.rotation[k] @ chain.axis[k])[:, None] * q
    if parent is None:  # the base is at rest
        return state_, np.zeros_like(offset)
    accel_, linear_ = state_[:, 2], state_[:, 4::2]
    omega, alpha = parent.omega, parent.alpha
    turned = cross(accel_, omega)
    arm_ = cross(accel_, alpha) + cross(turned, omega)
    arm_ += cross(linear_, parent.angular).sum(axis=1)
    out = state_.copy()
    out[:, 0] += cross(cross(omega, offset), accel_) + cross(offset, turned)
    out[:, 1] += cross(offset, accel_)
    out[:, 3::2] += cross(offset[:, None], linear_)
    return out, arm_


def _turn_back(chain: Chain, k: int, q: Array, x: Array) -> Array:
    """R(q) x, from the frame of link k to its parent's; x has shape (3, K, N)."""
    fixed = chain.rotation[k]
    if not chain.revolute[k]:
        return np.tensordot(fixed, x, axes=1)
    axis = chain.axis[k]
    across = cross(axis[:, None, None], x)  # axis × x
    twice = cross(axis[:, None, None], across)
    turned = x + np.sin(q) * across + (1.0 - np.cos(q)) * twice
    return np.tensordot(fixed, turned, axes=1)


def _add_block(link: LinkMotion, P: Array, state_: Array) -> None:
    """Add the derivatives of one link's weighted columns by its motion and screws.

    With weights (m, c, I) in place of inertial parameters the sum is l·f + u·n over the
    joints, f = m·a + α×c + ω×(ω×c) and n = I·α + ω×(I·ω) + c×a.

    Args:
        link: Motion of the link.
        P: Weights, shape (k+1, 10, N).
        state_: Derivatives to add to, shape (3, 3 + 2(k+1), N).
    """
    m, c = P[:, 0], P[:, 1:4].transpose(1, 0, 2)  # (k+1, N), (3, k+1, N)
    omega, alpha, accel = (x[:, None] for x in (link.omega, link.alpha, link.accel))
    u, l_ = link.angular, link.linear
    lever, spun = cross(omega, c), _inertia(P, omega)
    state_[:, 3::2] += _inertia(P, alpha) + cross(omega, spun) + cross(c, accel)
    state_[:, 4::2] += m * accel + cross(alpha, c) + cross(omega, lever)
    state_[:, 2] += (m * l_ + cross(u, c)).sum(axis=1)
    state_[:, 1] += (cross(c, l_) + _inertia(P, u)).sum(axis=1)
    by_omega = cross(lever, l_) + cross(c, cross(l_, omega))
    by_omega += cross(spun, u) + _inertia(P, cross(u, omega))
    state_[:, 0] += by_omega.sum(axis=1)


def _inertia(P: Array, x: Array) -> Array:
    """I x, with the six entries of I in P[:, 4:]; x has shape (3, k+1 or 1, N)."""
    xx, xy, yy, xz, yz, zz = P[:, 4:].transpose(1, 0, 2)
    return np.stack(
        [
            xx * x[0] + xy * x[1] + xz * x[2],
            xy * x[0] + yy * x[1] + yz * x[2],
            xz * x[0] + yz * x[1] + zz * x[2],
        ]
    )


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("cn,cn->n", x, y))
