"""How much of the torque an arm of real masses explains.

Whatever the robot file says of its links, they consist of masses that are not
negative, within reach of their joints; rotors have no negative inertia, and friction
takes energy. Torque of a log that is read right is a sum with positive weights

    τ = Σ m_p Y(q, v, a) u_p + J a + F_v v + F_c sgn v + k (q − q₀) + offset

of what unit masses at fixed points of each link ask for (u_p holds the ten parameters
of such a mass), of rotor and friction at each joint, and of a spring there, in the file
or not: a cable is one.
Swapped columns, wrong signs and a wrong clock ask for negative masses, or leave torque
that no mass explains.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hybrid.arrays import Array
from hybrid.dynamics.regressor import regressor
from hybrid.inspect.state import State
from hybrid.robot.chain import Chain

_REACH = 0.25  # of the arm's length: how far masses of a link, or a tool, may be
_CREEP = 0.02  # of the highest speed: below, dry friction changes its sign gradually
_OWN = 5  # columns of each joint's drive: rotor, viscous, dry, offset either way
_OFFSET = 0.1  # of an offset counts as left over
_LEAST = 1e-3  # of a torque's variance: less left is as good as nothing
_RANK = 1e-4  # of the largest singular value: below, columns are not told apart
_ROUNDS = 10  # times the number of weights
_RIDGE = 1e-8  # of a column's square
_TINY, _NONE = 1e-9, 1e-300


def unit_masses(chain: Chain) -> Array:
    """Inertial parameters of masses of 1 kg at points of each link, shape (10n, P).

    The points of a link are its origin and the corners of an octahedron about it:
    sums of them have any mass and centre, and any moments of inertia, within reach.
    """
    lengths = np.linalg.norm(chain.translation, axis=1)
    arm = float(lengths.sum()) or 1.0
    directions = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])
    columns = np.zeros((10 * chain.size, chain.size * len(directions)))
    for k in range(chain.size):
        beyond = lengths[k + 1] if k + 1 < chain.size else 0.0
        x, y, z = max(float(beyond), _REACH * arm) * directions.T
        own = slice(k * len(directions), (k + 1) * len(directions))
        rest = y * y + z * z, -x * y, x * x + z * z, -x * z, -y * z, x * x + y * y
        columns[10 * k : 10 * k + 10, own] = [np.ones_like(x), x, y, z, *rest]
    return columns


def file_masses(chain: Chain) -> Array:
    """Inertial parameters of each link as the file has them, shape (10n, n)."""
    columns = np.zeros((10 * chain.size, chain.size))
    for k, link in enumerate(chain.inertial):
        columns[10 * k : 10 * k + 10, k] = link
    return columns


class MassColumns:
    """Torque per unit of every mass and drive along a motion, as normal equations.

    Args:
        chain: The arm.
        state: M samples.
        masses: Parameters of each mass, shape (10n, P).

    Attributes:
        explained: Torque by the weights found last, shape (M, n), [N·m].
    """

    def __init__(self, chain: Chain, state: State, masses: Array) -> None:
        rigid = regressor(chain, state.q, state.v, state.a) @ masses
        columns = np.concatenate([rigid, _drives(state)], axis=2).transpose(1, 0, 2)
        n = chain.size
        size = np.maximum(np.sqrt((columns**2).sum(axis=(0, 1))), _TINY)
        self._each = columns / size  # (n, M, P + 6n)
        self._normal = self._each.transpose(0, 2, 1) @ self._each
        self._normal += _offset_costs(size, n, masses.shape[1]) * len(state.q)
        self._torque = state.tau
        self._right = np.einsum("imp,mc->icp", self._each, state.tau)
        self._squares = (state.tau**2).mean(axis=0)
        self.explained = np.zeros_like(state.tau)
        self._size = np.maximum(state.tau.var(axis=0), _TINY * self._squares + _NONE)

    def left(self, order: NDArray[np.intp], factor: Array, *, rounds: int = 2) -> Array:
        """Share of each torque's variance that the best positive weights leave, (n,).

        Args:
            order: Which column of torque is each joint's, shape (n,).
            factor: What it is to be multiplied by, shape (n,).
            rounds: Fits, from the second on with joints weighed by what the last left.
        """
        each, samples = np.arange(len(order)), len(self._torque)
        right = factor[:, None] * self._right[each, order] / samples
        squares = factor**2 * self._squares[order]
        size = factor**2 * self._size[order]
        normal = self._normal / samples
        share = np.ones(len(order))
        for _ in range(rounds):
            weight = 1.0 / (size * share)
            theta = _positive(np.tensordot(weight, normal, 1), weight @ right)
            rest = squares + ((normal @ theta - 2 * right) * theta).sum(axis=1)
            share = np.clip(rest / size, _LEAST, None)
        self.explained = (self._each @ theta).T
        return np.asarray(share, dtype=np.float64)

    def left_alone(self) -> Array:
        """Share of each column of torque that each joint's own columns leave, (n, n).

        Any weights are allowed, and joints have theirs apart: this asks which column
        may be whose, not which way it counts. Entry (i, c) is of column c at joint i.
        """
        left = []
        for columns in self._each:
            basis, value, _ = np.linalg.svd(columns, full_matrices=False)
            basis = basis[:, value > _RANK * value[0]]
            rest = self._torque - basis @ (basis.T @ self._torque)
            left.append((rest**2).mean(axis=0) / self._size)
        return np.asarray(np.clip(left, _LEAST, 1.0))


def direction(v: Array) -> Array:
    """Sign of speeds, shape (M, n), that changes gradually where they creep."""
    fastest = np.maximum(np.abs(v).max(axis=0), _TINY)
    return np.asarray(np.tanh(v / (_CREEP * fastest)))


def _drives(state: State) -> Array:
    """Columns of rotors, friction, offsets and springs, shape (M, n, 6n)."""
    samples, n = state.q.shape
    drive = np.zeros((samples, n, n, _OWN))
    dry = direction(state.v)
    own = np.stack([state.a, state.v, dry, np.ones_like(dry), -np.ones_like(dry)], -1)
    each = np.arange(n)
    drive[:, each, each] = own
    drives = drive.reshape(samples, n, _OWN * n)
    relaxed = np.full(n, np.nan) if state.relaxed is None else state.relaxed
    relaxed = np.where(np.isfinite(relaxed), relaxed, state.q.mean(axis=0))
    spring = np.zeros((samples, n, n))
    spring[:, each, each] = state.q - relaxed
    return np.concatenate([drives, spring], axis=2)


def _offset_costs(size: Array, joints: int, masses: int) -> Array:
    """Squares of offsets that count as left over, shape (n, P + 6n, P + 6n).

    Torque that never changes may be held by an offset, but gravity is likelier.
    """
    costs = np.zeros((joints, len(size), len(size)))
    for j in range(joints):
        for k in (3, 4):
            at = masses + _OWN * j + k
            costs[j, at, at] = (_OFFSET / size[at]) ** 2
    return costs


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
