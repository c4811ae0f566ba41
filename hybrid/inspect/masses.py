"""Fit the torque of a log with masses that may exist, whatever the robot file says.

The torque of a log that is read right is a sum with non-negative weights

    τ = Σ m_p Y(q, v, a) u_p + J a + F_v v + F_c sgn v + k (q − q₀) + offset

of unit masses at fixed points of each link (u_p holds the ten inertial parameters of
such a mass), of rotor inertia and friction at each joint, and of a spring there, which
may be a cable. No spring is stronger than the drive that moves it. Swapped columns,
wrong signs and a wrong clock need negative masses, or leave a large residual.
"""

import numpy as np

from hybrid.arrays import Array, Index, Mask
from hybrid.inspect.state import State
from hybrid.robot import Robot
from hybrid.robot.chain import Chain

CREEP = 0.02  # of the highest speed: width of the sign change of dry friction
_REACH = 0.25  # of the arm's length: least distance of masses from their link's origin
_SPRING, _OFFSETS = 3, slice(4, 6)  # among the columns of a drive
_OFFSET_PENALTY = 0.1  # share of an offset that counts as residual: gravity is likelier
_NEGLIGIBLE = 1e-3  # share of a torque's variance
_RANK = 1e-4  # smallest singular value, over the largest
_ITERATIONS = 10  # per weight
_RIDGE = 1e-8  # of a column's square
_TINY, _NONE = 1e-9, 1e-300

# Products of the columns (n, P, P), those with each torque (n, n, P), and squares of
# each torque (n,): sums over some samples, over the number of all.
_Sums = tuple[Array, Array, Array]


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


class MassColumns:
    """Columns of every mass and drive along a motion, as normal equations.

    Args:
        robot: The arm, with its ratings and springs.
        state: M samples.
        masses: Parameters of some masses of each link, shape (n, 10, p).
        Y: Regressor along the samples, shape (M, n, 10n).
    """

    def __init__(self, robot: Robot, state: State, masses: Array, Y: Array) -> None:
        (samples, n), self._tau = state.q.shape, state.tau
        own, each = _drive_columns(robot, state), np.arange(n)
        drives = np.zeros((n, n, *own.shape[1:]))  # joint, drive, column, sample
        drives[each, each] = own
        links = masses.swapaxes(1, 2) @ Y.transpose(1, 2, 0).reshape(n, n, 10, samples)
        columns = np.concatenate(
            [links.reshape(n, -1, samples), drives.reshape(n, -1, samples)], axis=1
        )  # (n, P, M)
        self._scale = np.maximum(np.sqrt((columns**2).sum(axis=(0, 2))), _TINY)
        self._columns = columns / self._scale[:, None]
        of_drives = np.arange(-drives[0, :, :, 0].size, 0).reshape(n, -1)
        self._offsets = of_drives[:, _OFFSETS]
        travel = np.maximum(np.abs(own[:, _SPRING]).max(axis=1), _TINY)
        self._upper = np.full(len(self._scale), np.inf)
        self._upper[of_drives[:, _SPRING]] = robot.tau_max / travel
        self._upper *= self._scale
        self._all = self._sums(slice(None))
        least = _TINY * self._all[2] + _NONE
        self._size = np.maximum(state.tau.var(axis=0), least)
        self._theta = np.zeros(len(self._scale))

    @property
    def explained(self) -> Array:
        """Torque by the last fit to the whole log, shape (M, n), [N·m]."""
        return np.asarray(self._columns.swapaxes(1, 2) @ self._theta).T

    def residual(
        self,
        order: Index,
        factor: Array,
        *,
        rounds: int = 2,
        blocks: int = 1,
    ) -> Array:
        """Share of each torque's variance that a non-negative fit leaves, shape (n,).

        Args:
            order: Torque column of each joint, shape (n,).
            factor: Factor of each torque, shape (n,).
            rounds: Number of fits; each weighs joints by the residual of the last.
            blocks: Parts of the log in time. Of several, odd ones are predicted by a
                fit of the even ones, and these by one of the odd ones. The share is
                then 1 at the most.
        """
        torque = order, factor
        if blocks == 1:
            self._theta = self._fitted(self._all, *torque, rounds)
            return self._shares(self._all, self._theta, *torque)
        samples, left = len(self._tau), np.zeros(len(order))
        odd = np.arange(samples) * blocks // samples % 2 == 1
        parts = self._sums(odd), self._sums(~odd)
        for seen, unseen in (parts, parts[::-1]):
            left += self._shares(unseen, self._fitted(seen, *torque, rounds), *torque)
        return np.minimum(left, 1.0)

    def residual_of_pairs(self) -> Array:
        """Share of torque column c that the columns of joint i leave, shape (n, n).

        Row i is joint i. Weights have any sign, and differ from joint to joint: this
        tests the order of torque columns, not their sign.
        """
        left = []
        for columns in self._columns:
            used = columns[columns.any(axis=1)]
            _, value, basis = np.linalg.svd(used, full_matrices=False)
            basis = basis[value > _RANK * value[0]]
            rest = self._tau - basis.T @ (basis @ self._tau)
            left.append((rest**2).mean(axis=0) / self._size)
        return np.asarray(np.clip(left, _NEGLIGIBLE, 1.0))

    def _sums(self, use: Mask | slice) -> _Sums:
        """Normal equations over some of the samples, (M,)."""
        columns, tau = self._columns[:, :, use], self._tau[use]
        samples = len(self._tau)
        normal = columns @ columns.swapaxes(1, 2)
        each, offsets = np.arange(len(columns))[:, None], self._offsets
        penalty = _OFFSET_PENALTY / self._scale[offsets]
        normal[each, offsets, offsets] += penalty**2 * len(tau)
        right = (columns @ tau).swapaxes(1, 2)
        return normal / samples, right / samples, (tau**2).sum(axis=0) / samples

    def _fitted(self, sums: _Sums, order: Index, factor: Array, rounds: int) -> Array:
        """Weights of the columns, shape (P,)."""
        normal, products, _ = sums
        right = factor[:, None] * products[np.arange(len(order)), order]
        share, theta = np.ones(len(order)), self._theta
        for _ in range(rounds):
            weight = 1.0 / (factor**2 * self._size[order] * share)
            theta = _bounded(
                np.tensordot(weight, normal, 1), weight @ right, self._upper
            )
            share = self._shares(sums, theta, order, factor)
        return theta

    def _shares(self, sums: _Sums, theta: Array, order: Index, factor: Array) -> Array:
        """What weights leave of samples, over the variance of all, shape (n,)."""
        normal, products, squares = sums
        right = factor[:, None] * products[np.arange(len(order)), order]
        rest = ((normal @ theta - 2 * right) * theta).sum(axis=1)
        rest += factor**2 * squares[order]
        share = rest / (factor**2 * self._size[order])
        return np.asarray(np.clip(share, _NEGLIGIBLE, None))


def smooth_sign(v: Array) -> Array:
    """Sign of speeds, shape (M, n), with a gradual change about zero."""
    fastest = np.maximum(np.abs(v).max(axis=0), _TINY)
    return np.asarray(np.tanh(v / (CREEP * fastest)))


def _drive_columns(robot: Robot, state: State) -> Array:
    """Rotor, viscous and dry friction, spring, and offsets of both signs, (n, 6, M)."""
    relaxed = np.where(robot.stiffness > 0, robot.springref, state.q.mean(axis=0))
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
    from scipy.linalg import solve_triangular
    from scipy.optimize import nnls

    size = np.sqrt(np.maximum(np.diagonal(normal), _NONE))
    scaled = normal / size / size[:, None] + _RIDGE * np.eye(len(size))
    root = np.linalg.cholesky(scaled)
    target = solve_triangular(root, right / size, lower=True, check_finite=False)
    try:
        weights = nnls(root.T, target, maxiter=_ITERATIONS * len(size))[0]
    except RuntimeError:  # it did not converge
        weights = np.maximum(np.linalg.solve(root.T, target), 0.0)
    return np.asarray(weights / size)
