"""Fit the torque of a log with masses that may exist, whatever the robot file says.

The torque of a log that is read right is a sum with non-negative weights

    τ = Σ m_p Y(q, v, a) u_p + J a + F_v v + F_c sgn v + k (q − q₀) + offset

of unit masses at fixed points of each link (u_p holds the ten inertial parameters of
such a mass), of rotor inertia and friction at each joint, and of a spring there, which
may be a cable. No spring is stronger than the drive that moves it. Swapped columns,
wrong signs and a wrong clock need negative masses, or leave a large residual.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.inspect.state import State
from hybrid.robot.chain import Chain

CREEP = 0.02  # of the highest speed: width of the sign change of dry friction
_REACH = 0.25  # of the arm's length: least distance of masses from their link's origin
_DRIVE_COLUMNS = 6  # rotor, viscous, dry, spring, positive and negative offset
_OFFSET_PENALTY = 0.1  # share of an offset that counts as residual: gravity is likelier
_NEGLIGIBLE = 1e-3  # share of a torque's variance
_RANK = 1e-4  # smallest singular value, over the largest
_ITERATIONS = 10  # per weight
_RIDGE = 1e-8  # of a column's square
_TINY, _NONE = 1e-9, 1e-300


def unit_masses(chain: Chain) -> Array:
    """Inertial parameters of masses of 1 kg at points of each link, shape (n, 10, 7).

    The points are the link's origin and the corners of an octahedron about it. Their
    non-negative combinations cover any mass, centre and moments of inertia in reach,
    which the next joint, the arm's length, and the file's centres of mass tell.
    """
    lengths = np.linalg.norm(chain.translation, axis=1)
    arm = float(lengths.sum()) or 1.0
    mass, moment = chain.inertial[:, :1], chain.inertial[:, 1:4]
    centre = np.linalg.norm(moment / np.maximum(mass, _TINY), axis=1)
    beyond = np.maximum(np.maximum(np.append(lengths[1:], 0.0), centre), _REACH * arm)
    directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    x, y, z = np.moveaxis(beyond[:, None, None] * directions, 2, 0)  # (n, 7) each
    rest = y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y
    return np.stack([np.ones_like(x), x, y, z, *rest], axis=1)


class MassColumns:
    """Columns of every mass and drive along a motion, as normal equations.

    Args:
        state: M samples.
        masses: Parameters of P masses of each link, shape (n, 10, P).
        Y: Regressor along the samples, shape (M, n, 10n).
    """

    def __init__(self, state: State, masses: Array, Y: Array) -> None:
        (samples, n), each = state.q.shape, masses.shape[2]
        links = Y.transpose(1, 2, 0).reshape(n, n, 10, samples)
        drives, count = _drive_columns(state), n * (each + _DRIVE_COLUMNS)
        self._own, self._places = [], []  # columns at each joint, and their numbers
        self._normal = np.zeros((n, count, count))
        self._right = np.zeros((n, n, count))
        for i in range(n):  # links before joint i do not load it
            rigid = masses[i:].transpose(0, 2, 1) @ links[i, i:]  # (n - i, P, M)
            own = np.concatenate([rigid.reshape(-1, samples), drives[i]])
            drive = n * each + _DRIVE_COLUMNS * i + np.arange(_DRIVE_COLUMNS)
            at = np.append(np.arange(i * each, n * each), drive)
            self._own.append(own)
            self._places.append(at)
            self._normal[i][np.ix_(at, at)] = own @ own.T
            self._right[i][:, at] = (own @ state.tau).T
        size = np.sqrt(np.diagonal(self._normal.sum(axis=0)))
        self._scale = np.maximum(size, _TINY)
        for i, at in enumerate(self._places):
            offsets = at[-2:]
            self._normal[i][offsets, offsets] += _OFFSET_PENALTY**2 * samples
        self._normal /= self._scale * self._scale[:, None] * samples
        self._right /= self._scale * samples
        self._torque = state.tau
        self._squares = (state.tau**2).mean(axis=0)
        self._size = np.maximum(state.tau.var(axis=0), _TINY * self._squares + _NONE)
        self._theta = np.zeros(count)
        self._upper = np.full(count, np.inf)
        spring = n * each + 3 + _DRIVE_COLUMNS * np.arange(n)
        travel = np.abs(drives[:, 3]).max(axis=1)
        self._upper[spring] = state.rated / np.maximum(travel, _TINY)
        self._upper *= self._scale

    @property
    def explained(self) -> Array:
        """Torque by the last fit, shape (M, n), [N·m]."""
        theta = self._theta / self._scale
        pairs = zip(self._own, self._places, strict=True)
        return np.stack([theta[at] @ own for own, at in pairs], axis=1)

    def residual(
        self, order: NDArray[np.intp], factor: Array, *, rounds: int = 2
    ) -> Array:
        """Share of each torque's variance that a non-negative fit leaves, shape (n,).

        Args:
            order: Torque column of each joint, shape (n,).
            factor: Factor of each torque, shape (n,).
            rounds: Number of fits; each weighs joints by the residual of the last.
        """
        each = np.arange(len(order))
        right = factor[:, None] * self._right[each, order]
        squares = factor**2 * self._squares[order]
        size = factor**2 * self._size[order]
        share = np.ones(len(order))
        for _ in range(rounds):
            weight = 1.0 / (size * share)
            normal = np.tensordot(weight, self._normal, 1)
            self._theta = theta = _bounded(normal, weight @ right, self._upper)
            rest = squares + ((self._normal @ theta - 2 * right) * theta).sum(axis=1)
            share = np.clip(rest / size, _NEGLIGIBLE, None)
        return np.asarray(share, dtype=np.float64)

    def residual_of_pairs(self) -> Array:
        """Share of torque column c that the columns of joint i leave, shape (n, n).

        Row i is joint i. Weights have any sign, and differ from joint to joint: this
        tests the order of torque columns, not their sign.
        """
        left = []
        for own, at in zip(self._own, self._places, strict=True):
            columns = own.T / self._scale[at]
            basis, value, _ = np.linalg.svd(columns, full_matrices=False)
            basis = basis[:, value > _RANK * value[0]]
            rest = self._torque - basis @ (basis.T @ self._torque)
            left.append((rest**2).mean(axis=0) / self._size)
        return np.asarray(np.clip(left, _NEGLIGIBLE, 1.0))


def smooth_sign(v: Array) -> Array:
    """Sign of speeds, shape (M, n), with a gradual change about zero."""
    fastest = np.maximum(np.abs(v).max(axis=0), _TINY)
    return np.asarray(np.tanh(v / (CREEP * fastest)))


def _drive_columns(state: State) -> Array:
    """Columns of rotor, friction, spring and offset of each joint, shape (n, 6, M)."""
    free = np.isnan(state.relaxed)
    relaxed = np.where(free, state.q.mean(axis=0), state.relaxed)
    dry, one = smooth_sign(state.v), np.ones_like(state.v)
    own = state.a, state.v, dry, state.q - relaxed, one, -one
    return np.stack([x.T for x in own], axis=1)


def _bounded(normal: Array, right: Array, upper: Array) -> Array:
    """Solve normal equations by non-negative weights up to upper bounds, shape (P,)."""
    weights = _non_negative(normal, right)
    over = weights > upper
    if over.any():
        weights[over], free = upper[over], ~over
        right = right[free] - normal[np.ix_(free, over)] @ upper[over]
        weights[free] = _non_negative(normal[np.ix_(free, free)], right)
    return weights


def _non_negative(normal: Array, right: Array) -> Array:
    """Solve normal equations by non-negative weights, shape (P,)."""
    from scipy.optimize import nnls

    size = np.sqrt(np.maximum(np.diagonal(normal), _NONE))
    scaled = normal / size / size[:, None] + _RIDGE * np.eye(len(size))
    root = np.linalg.cholesky(scaled)
    target = np.linalg.solve(root, right / size)
    try:
        weights = nnls(root.T, target, maxiter=_ITERATIONS * len(size))[0]
    except RuntimeError:  # it did not converge
        weights = np.maximum(np.linalg.solve(root.T, target), 0.0)
    return np.asarray(weights / size)
