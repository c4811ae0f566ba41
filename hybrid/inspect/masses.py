"""Fit the torque of a log with masses that may exist, whatever the robot file says.

The torque of a log that is read right is a sum with non-negative weights

    τ = Σ m_p Y(q, v, a) u_p + J a + F_v v + F_c sgn v + k (q − q₀) + offset

of unit masses at fixed points of each link (u_p holds the ten inertial parameters of
such a mass), of rotor inertia and friction at each joint, and of a spring there, which
may be a cable. No spring is stronger than the drive that moves it. Swapped columns,
wrong signs and a wrong clock need negative masses, or leave a large residual.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    none = np.zeros_like(x)  # products of coordinates: each point lies on an axis
    rest = y * y + z * z, none, x * x + z * z, none, none, x * x + y * y
    return np.stack([np.ones_like(x), x, y, z, *rest], axis=1)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over samples, over the number of all samples.

    Attributes:
        normal: Products of the columns at each joint, shape (n, P, P).
        right: Products of the columns at each joint with each torque, shape (n, n, P).
        squares: Squares of each torque, shape (n,).
    """

    normal: Array
    right: Array
    squares: Array


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
        drives, self._count = _drive_columns(state), n * (each + _DRIVE_COLUMNS)
        self._own, self._places = [], []  # columns at each joint, and their numbers
        for i in range(n):  # links before joint i do not load it
            rigid = masses[i:].transpose(0, 2, 1) @ links[i, i:]  # (n - i, P, M)
            drive = n * each + _DRIVE_COLUMNS * i + np.arange(_DRIVE_COLUMNS)
            self._own.append(np.concatenate([rigid.reshape(-1, samples), drives[i]]))
            self._places.append(np.append(np.arange(i * each, n * each), drive))
        square = np.zeros(self._count)
        for own, at in zip(self._own, self._places, strict=True):
            square[at] += np.einsum("pm,pm->p", own, own)
        self._scale = np.maximum(np.sqrt(square), _TINY)
        self._torque = state.tau
        self._all = self._sums(np.ones(samples, dtype=bool))
        least = _TINY * self._all.squares + _NONE
        self._size = np.maximum(state.tau.var(axis=0), least)
        self._theta = np.zeros(self._count)
        self._upper = np.full(self._count, np.inf)
        spring = n * each + 3 + _DRIVE_COLUMNS * np.arange(n)
        travel = np.abs(drives[:, 3]).max(axis=1)
        self._upper[spring] = state.rated / np.maximum(travel, _TINY)
        self._upper *= self._scale

    def _sums(self, use: NDArray[np.bool_]) -> _Sums:
        """Normal equations over some of the samples, (M,)."""
        n, count = len(self._own), self._count
        normal, right = np.zeros((n, count, count)), np.zeros((n, n, count))
        for i, (every, at) in enumerate(zip(self._own, self._places, strict=True)):
            own, offsets = every[:, use], at[-2:]
            normal[i][np.ix_(at, at)] = own @ own.T
            right[i][:, at] = (own @ self._torque[use]).T
            normal[i][offsets, offsets] += _OFFSET_PENALTY**2 * use.sum()
        return _Sums(
            normal / (self._scale * self._scale[:, None] * len(use)),
            right / (self._scale * len(use)),
            (self._torque[use] ** 2).sum(axis=0) / len(use),
        )

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
        self._theta = self._fitted(self._all, order, factor, rounds)
        return self._shares(self._all, self._theta, order, factor)

    def unseen(self, order: NDArray[np.intp], factor: Array, blocks: int) -> Array:
        """The same of samples that a fit does not see, shape (n,); 1 at the most.

        Args:
            order: Torque column of each joint, shape (n,).
            factor: Factor of each torque, shape (n,).
            blocks: Parts of the log in time. Odd ones are predicted by a fit of the
                even ones, and these by one of the odd ones.
        """
        samples = len(self._torque)
        odd = np.arange(samples) * blocks // samples % 2 == 1
        parts = self._sums(odd), self._sums(~odd)
        left = np.zeros(len(order))
        for fitted, other in (parts, parts[::-1]):
            theta = self._fitted(fitted, order, factor, 2)
            left += self._shares(other, theta, order, factor)
        return np.minimum(left, 1.0)

    def _fitted(
        self, sums: _Sums, order: NDArray[np.intp], factor: Array, rounds: int
    ) -> Array:
        """Weights of the columns, shape (P,)."""
        right = factor[:, None] * sums.right[np.arange(len(order)), order]
        share, theta = np.ones(len(order)), self._theta
        for _ in range(rounds):
            weight = 1.0 / (factor**2 * self._size[order] * share)
            normal = np.tensordot(weight, sums.normal, 1)
            theta = _bounded(normal, weight @ right, self._upper)
            share = self._shares(sums, theta, order, factor)
        return theta

    def _shares(
        self, sums: _Sums, theta: Array, order: NDArray[np.intp], factor: Array
    ) -> Array:
        """What weights leave of samples, over the variance of all, shape (n,)."""
        right = factor[:, None] * sums.right[np.arange(len(order)), order]
        rest = ((sums.normal @ theta - 2 * right) * theta).sum(axis=1)
        rest += factor**2 * sums.squares[order]
        share = rest / (factor**2 * self._size[order])
        return np.asarray(np.clip(share, _NEGLIGIBLE, None))

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
