"""Constraints on the distance between links, and on their height above a floor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.dynamics.kinematics import frames
from hybrid.errors import warn
from hybrid.excitation.constraints import Constraint, Limits
from hybrid.excitation.path import Path
from hybrid.robot.chain import Chain
from hybrid.robot.geometry import Capsules, capsules_from_robot
from hybrid.robot.robot import Robot

_LENGTH = 0.2  # m, unit of the excess of a distance
_POSTURES = 300
# The capsules of links two joints apart, as in a wrist, may touch in most postures.
_MOST_CONTACT = 0.3  # share of postures in contact above which a pair is left out
_JOINED = 0.95  # share of postures in contact above which a pair is joined by design


@dataclass(frozen=True, eq=False)
class Clearance(Constraint):
    """A least distance, ``margin`` [m], between links that are not neighbours.

    Capsules cover the geometry of the links, so their distance is a lower bound. Each
    of the ``pairs`` of capsules, shape (K, 2), is one condition: the distance of two
    links is not smooth where other capsules become the closest ones, which would stop
    the solver.
    """

    robot: Robot
    capsules: Capsules
    pairs: Index
    margin: float

    @classmethod
    def of(cls, robot: Robot, limits: Limits, *, margin: float = 0.01) -> Clearance:
        """Keep apart all links that are not neighbours and do not always touch.

        Raises:
            RobotError: The robot's file has no collision geometry.

        Warns:
            HybridWarning: A moving link has no geometry, or a pair is left out because
                its capsules often touch.
        """
        capsules = capsules_from_robot(robot)
        links = np.unique(capsules.link)
        if bare := [x for k, x in enumerate(robot.joints) if k not in links]:
            warn(f"not kept apart, without collision geometry: {', '.join(bare)}")
        own = {i: np.flatnonzero(capsules.link == i) for i in links.tolist()}
        apart = [list(product(own[i], own[j])) for i in own for j in own if j > i + 1]
        pairs = np.array([x for both in apart for x in both], dtype=np.intp)
        every = cls(robot, capsules, pairs.reshape(-1, 2), margin)
        q = np.random.default_rng(0).uniform(
            limits.low, limits.high, (_POSTURES, robot.size)
        )
        # Two links touch where any of their capsules do.
        sizes = [len(both) for both in apart]
        parts = np.split(every.distance(q) < margin, np.cumsum(sizes), axis=1)
        share = np.repeat([x.any(axis=1).mean() for x in parts], [*sizes, 0])
        often = (share > _MOST_CONTACT) & (share < _JOINED)
        if often.any():
            left_out = replace(every, pairs=every.pairs[often]).names
            named = ", ".join(x.split("links of ")[1] for x in dict.fromkeys(left_out))
            warn(f"not kept apart, as their capsules touch too often: {named}")
        return replace(every, pairs=every.pairs[share <= _MOST_CONTACT])

    @property
    def links(self) -> Index:
        """Links of each pair, −1 for the base, shape (K, 2)."""
        return np.asarray(self.capsules.link[self.pairs])

    @property
    def names(self) -> tuple[str, ...]:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        joints = ("base", *self.robot.joints)
        return tuple(
            f"closeness of the links of {joints[i + 1]} and {joints[j + 1]}"
            for i, j in self.links
        )

    def distance(self, q: Array) -> Array:
        """Distance of each pair, negative where capsules overlap, (N, K), [m]."""
        first, second = self.pairs.T
        ends = ends_in_world(self.robot.chain, self.capsules, q)
        x, y = closest_points(ends[:, first], ends[:, second])
        radius = self.capsules.radius[first] + self.capsules.radius[second]
        return np.asarray(np.sqrt(_dot(x - y, x - y)) - radius)

    def excess(self, path: Path) -> Array:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        return np.asarray((self.margin - self.distance(path.q)) / _LENGTH)

    def slope(self, path: Path, which: Index) -> Array:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        chain, capsules, q = self.robot.chain, self.capsules, path.q
        first, second = self.pairs[which].T
        ends, rows = ends_in_world(chain, capsules, q), np.arange(len(which))
        x, y = closest_points(ends[rows, first], ends[rows, second])
        away = x - y
        away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        change = point_change(chain, q, capsules.link[first], x, away)
        change -= point_change(chain, q, capsules.link[second], y, away)
        return _by_position(-change / _LENGTH)


@dataclass(frozen=True, eq=False)
class Floor(Constraint):
    """A height in the base frame, [m], that every moving link stays above."""

    robot: Robot
    capsules: Capsules
    height: float

    @cached_property
    def _ends(self) -> tuple[Index, Index]:
        """Capsule and end (0 or 1) of each condition, shape (K,)."""
        moving = np.flatnonzero(self.capsules.link >= 1)
        return np.repeat(moving, 2), np.tile([0, 1], len(moving))

    @property
    def names(self) -> tuple[str, ...]:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        links = self.capsules.link[self._ends[0]]
        return tuple(f"lowest z of the link of {self.robot.joints[k]}" for k in links)

    def excess(self, path: Path) -> Array:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        capsule, end = self._ends
        z = ends_in_world(self.robot.chain, self.capsules, path.q)[:, capsule, end, 2]
        least = self.height + self.capsules.radius[capsule]
        return np.asarray((least - z) / _LENGTH)

    def slope(self, path: Path, which: Index) -> Array:
        """See :class:`~hybrid.excitation.constraints.Constraint`."""
        capsule, end = (x[which] for x in self._ends)
        chain, rows = self.robot.chain, np.arange(len(which))
        point = ends_in_world(chain, self.capsules, path.q)[rows, capsule, end]
        down, link = np.array([0.0, 0.0, -1.0]), self.capsules.link[capsule]
        return _by_position(point_change(chain, path.q, link, point, down) / _LENGTH)


def ends_in_world(chain: Chain, capsules: Capsules, q: Array) -> Array:
    """End points of all capsules in the base frame, shape (N, C, 2, 3), [m]."""
    R, p, _ = frames(chain, q)
    out = np.tile(capsules.ends, (len(q), 1, 1, 1))  # as those of the base stay
    for link in range(chain.size):
        own = capsules.link == link
        ends = capsules.ends[own]
        turned = np.matmul(ends.reshape(-1, 3), R[link].transpose(0, 2, 1))
        moved = turned + p[link][:, None]
        out[:, own] = moved.reshape(len(q), *ends.shape)
    return out


def point_change(
    chain: Chain, q: Array, link: Index, point: Array, direction: Array
) -> Array:
    """Derivative by the joint positions of points along a direction, shape (N, n).

    Each point, shape (N, 3) in the base frame, belongs to a link (−1 for the base).
    """
    out = np.zeros_like(q)
    _, origin, axis = frames(chain, q)
    for j, turns in enumerate(chain.revolute):
        moved = np.cross(axis[j], point - origin[j]) if turns else axis[j]
        out[:, j] = (moved * direction).sum(axis=1) * (j <= link)
    return out


def _by_position(slope: Array) -> Array:
    """A slope (M, n) by position as one by all derivatives, shape (M, 4, n)."""
    return np.stack([slope, *np.zeros((3, *slope.shape))], axis=1)


def closest_points(first: Array, second: Array) -> tuple[Array, Array]:
    """Closest points of two segments with end points of shape (..., 2, 3), [m].

    See Ericson 2005, Real-Time Collision Detection, section 5.1.9.
    """
    p, d = first[..., 0, :], first[..., 1, :] - first[..., 0, :]
    r, e = second[..., 0, :], second[..., 1, :] - second[..., 0, :]
    dd, ee, de = _dot(d, d), _dot(e, e), _dot(d, e)
    between = p - r
    dp, ep = _dot(d, between), _dot(e, between)
    # For parallel segments and for points, any point of the first will do.
    determinant, tiny = dd * ee - de * de, 1e-12
    along = (de * ep - dp * ee) / np.maximum(determinant, tiny)
    s = np.clip(np.where(determinant > tiny, along, 0.0), 0.0, 1.0)
    # If t lies outside the second segment, the closest point is at its end.
    t = np.clip((de * s + ep) / np.maximum(ee, tiny), 0.0, 1.0)
    s = np.clip((de * t - dp) / np.maximum(dd, tiny), 0.0, 1.0)
    s = np.where(dd > tiny, s, 0.0)
    return p + s[..., None] * d, r + t[..., None] * e


def _dot(x: Array, y: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", x, y))
