"""How much of the torque an arm of real masses explains.

Whatever the robot file says of its links, they consist of masses that are not
negative, within reach of their joints; rotors have no negative inertia, and friction
takes energy. Torque of a log that is read right is a sum with positive weights

    τ = Σ m_p Y(q, v, a) u_p + J a + F_v v + F_c sgn v + k (q − q₀) + offset

of what unit masses at fixed points of each link ask for (u_p holds the ten parameters
of such a mass), of rotor and friction at each joint, and of a spring there, in the file
or not: a cable is one. No spring is stronger than the drive that has to move it.
Swapped columns, wrong signs and a wrong clock ask for negative masses, or leave torque
that no mass explains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.inspect.state import State
from hybrid.robot.chain import Chain

SURE = 0.5  # gain in log volume; of logs that are right, no other reading reached 0.3
CREEP = 0.02  # of the highest speed: below, dry friction changes its sign gradually
_REACH = 0.25  # of the arm's length: how far masses of a link, or a tool, may be
_OWN = 6  # columns of a drive: rotor, viscous, dry, spring, offset either way
_OFFSET = 0.1  # of an offset counts as left over: gravity is likelier
_LEAST = 1e-3  # of a torque's variance: less left is as good as nothing
_RANK = 1e-4  # of the largest singular value: below, columns are not told apart
_ROUNDS = 10  # times the number of weights
_RIDGE = 1e-8  # of a column's square
_TINY, _NONE = 1e-9, 1e-300


def unit_masses(chain: Chain) -> Array:
    """Inertial parameters of masses of 1 kg at points of each link, shape (n, 10, 7).

    The points of a link are its origin and the corners of an octahedron about it:
    sums of them have any mass and centre, and any moments of inertia, within reach.
    """
    lengths = np.linalg.norm(chain.translation, axis=1)
    arm = float(lengths.sum()) or 1.0
    beyond = np.maximum(np.append(lengths[1:], 0.0), _REACH * arm)
    directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    x, y, z = np.moveaxis(beyond[:, None, None] * directions, 2, 0)  # (n, 7) each
    rest = y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y
    return np.stack([np.ones_like(x), x, y, z, *rest], axis=1)


class MassColumns:
    """Torque per unit of every mass and drive along a motion, as normal equations.

    Args:
        state: M samples.
        masses: Parameters of P masses of each link, shape (n, 10, P).
        Y: Regressor along the samples, shape (M, n, 10n).
    """

    def __init__(self, state: State, masses: Array, Y: Array) -> None:
        (samples, n), each = state.q.shape, masses.shape[2]
        links = Y.transpose(1, 2, 0).reshape(n, n, 10, samples)
        drives, count = _drives(state), n * (each + _OWN)
        self._own, self._places = [], []
        self._normal = np.zeros((n, count, count))
        self._right = np.zeros((n, n, count))
        for i in range(n):  # whom links before it do not move
            rigid = masses[i:].transpose(0, 2, 1) @ links[i, i:]  # (n - i, P, M)
            own = np.concatenate([rigid.reshape(-1, samples), drives[i]])
            drive = n * each + _OWN * i + np.arange(_OWN)
            at = np.append(np.arange(i * each, n * each), drive)
            self._own.append(own)
            self._places.append(at)
            self._normal[i][np.ix_(at, at)] = own @ own.T
            self._right[i][:, at] = (own @ state.tau).T
        size = np.sqrt(np.diagonal(self._normal.sum(axis=0)))
        self._scale = np.maximum(size, _TINY)
        for i, at in enumerate(self._places):  # offsets are held to be left over
            k = at[-2:]
            self._normal[i][k, k] += _OFFSET**2 * samples
        self._normal /= self._scale * self._scale[:, None] * samples
        self._right /= self._scale * samples
        self._torque = state.tau
        self._squares = (state.tau**2).mean(axis=0)
        self._size = np.maximum(state.tau.var(axis=0), _TINY * self._squares + _NONE)
        self._theta = np.zeros(count)
        self._most = np.full(count, np.inf)
        spring, reach = n * each + 3 + _OWN * np.arange(n), np.abs(drives[:, 3]).max(1)
        self._most[spring] = state.rated / np.maximum(reach, _TINY)
        self._most *= self._scale

    @property
    def explained(self) -> Array:
        """Torque by the weights found last, shape (M, n), [N·m]."""
        theta = self._theta / self._scale
        pairs = zip(self._own, self._places, strict=True)
        return np.stack([theta[at] @ own for own, at in pairs], axis=1)

    def left(self, order: NDArray[np.intp], factor: Array, *, rounds: int = 2) -> Array:
        """Share of each torque's variance that the best positive weights leave, (n,).

        Args:
            order: Which column of torque is each joint's, shape (n,).
            factor: What it is to be multiplied by, shape (n,).
            rounds: Fits, from the second on with joints weighed by what the last left.
        """
        each = np.arange(len(order))
        right = factor[:, None] * self._right[each, order]
        squares = factor**2 * self._squares[order]
        size = factor**2 * self._size[order]
        share = np.ones(len(order))
        for _ in range(rounds):
            weight = 1.0 / (size * share)
            normal = np.tensordot(weight, self._normal, 1)
            self._theta = theta = _bounded(normal, weight @ right, self._most)
            rest = squares + ((self._normal @ theta - 2 * right) * theta).sum(axis=1)
            share = np.clip(rest / size, _LEAST, None)
        return np.asarray(share, dtype=np.float64)

    def left_alone(self) -> Array:
        """Share of each column of torque that each joint's own columns leave, (n, n).

        Any weights are allowed, and joints have theirs apart: this asks which column
        may be whose, not which way it counts. Entry (i, c) is of column c at joint i.
        """
        left = []
        for own, at in zip(self._own, self._places, strict=True):
            columns = own.T / self._scale[at]
            basis, value, _ = np.linalg.svd(columns, full_matrices=False)
            basis = basis[:, value > _RANK * value[0]]
            rest = self._torque - basis @ (basis.T @ self._torque)
            left.append((rest**2).mean(axis=0) / self._size)
        return np.asarray(np.clip(left, _LEAST, 1.0))


def direction(v: Array) -> Array:
    """Sign of speeds, shape (M, n), that changes gradually where they creep."""
    fastest = np.maximum(np.abs(v).max(axis=0), _TINY)
    return np.asarray(np.tanh(v / (CREEP * fastest)))


def _drives(state: State) -> Array:
    """Columns of each joint's rotor, friction, spring and offset, shape (n, 6, M)."""
    free = np.isnan(state.relaxed)
    relaxed = np.where(free, state.q.mean(axis=0), state.relaxed)
    dry, one = direction(state.v), np.ones_like(state.v)
    own = state.a, state.v, dry, state.q - relaxed, one, -one
    return np.stack([x.T for x in own], axis=1)


def _bounded(normal: Array, right: Array, most: Array) -> Array:
    """The same with upper bounds, shape (P,): what is beyond stays at them."""
    weights = _positive(normal, right)
    over = weights > most
    if over.any():
        weights[over], free = most[over], ~over
        right = right[free] - normal[np.ix_(free, over)] @ most[over]
        weights[free] = _positive(normal[np.ix_(free, free)], right)
    return weights


def _positive(normal: Array, right: Array) -> Array:
    """Solution of normal equations by weights that are not negative, shape (P,)."""
    from scipy.optimize import nnls

    size = np.sqrt(np.maximum(np.diagonal(normal), _NONE))
    scaled = normal / size / size[:, None] + _RIDGE * np.eye(len(size))
    root = np.linalg.cholesky(scaled)
    target = np.linalg.solve(root, right / size)
    try:
        weights = nnls(root.T, target, maxiter=_ROUNDS * len(size))[0]
    except RuntimeError:  # it went round in circles: near enough
        weights = np.maximum(np.linalg.solve(root.T, target), 0.0)
    return np.asarray(weights / size)
