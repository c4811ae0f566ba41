"""Rigid-body quantities along a motion, for effects."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from hybrid.arrays import Array
from hybrid.dynamics.kinematics import frames
from hybrid.dynamics.regressor import inverse_dynamics, regressor, regressor_law
from hybrid.robot import Robot
from hybrid.robot.chain import Chain
from hybrid.signals import Motion

_STEP = 1e-4  # rad or m, of a difference in position


class RigidBody:
    """The arm's rigid body along a motion; each quantity is computed once.

    Args:
        chain: The arm.
        motion: N samples of its motion.
        inertial: Link parameters, shape (n, 10); those of the chain by default. Any set
            with the right base parameters gives the right torque.
        slopes_of: The body along nearly the same motion, whose slopes serve here too.
    """

    def __init__(
        self,
        chain: Chain,
        motion: Motion,
        inertial: Array | None = None,
        slopes_of: RigidBody | None = None,
    ) -> None:
        self.chain = chain
        self.motion = motion
        self.inertial = chain.inertial if inertial is None else inertial
        self._slopes_of = slopes_of
        self._known_slopes: dict[int, tuple[Array, Array, Array]] = {}
        self._known_wrenches: dict[int, Array] = {}
        self._cubics: tuple[int, Array] = -1, np.zeros(0)

    @cached_property
    def load(self) -> Array:
        """Torque transmitted to the links, shape (N, n), [N·m]."""
        return self._torque(self.motion.q, self.motion.v, self.motion.a)

    @cached_property
    def columns(self) -> Array:
        """Regressor of all links, shape (N, n, 10n)."""
        return regressor(self.chain, self.motion.q, self.motion.v, self.motion.a)

    def link_columns(self, link: int) -> Array:
        """Torque per inertial parameter of one link, shape (N, n, 10); not kept."""
        n, m = self.chain.size, self.motion
        entries = np.arange(10 * n * n).reshape(n, n, 10)[:, link].ravel().tolist()
        rows = regressor_law(self.chain, tuple(entries)).rows((m.q, m.v, m.a))
        return rows.reshape(n, 10, -1).transpose(2, 0, 1)

    def response(self, j: int, dq: Array, dv: Array, da: Array) -> Array:
        """Change of rigid torque along a change of a joint's motion, (N, n), [N·m].

        It is linear in the changes of position, speed and acceleration, (N,) each.
        """
        by_q, by_v, by_a = self.slopes(j)
        return (by_q.T * dq + by_v.T * dv + by_a.T * da).T

    def slopes(self, j: int) -> tuple[Array, Array, Array]:
        """Partial derivatives of all torques by q, v and a of a joint, (N, n) each.

        Differences of the inverse dynamics. It is quadratic in speed and linear in
        acceleration, so only the step in position must be small.
        """
        if self._slopes_of is not None:
            return self._slopes_of.slopes(j)
        if j not in self._known_slopes:
            state = np.array([self.motion.q, self.motion.v, self.motion.a])

            def torque(at: int, step: float) -> Array:
                moved = state.copy()
                moved[at, :, j] += step
                return self._torque(*moved)

            by_q = (torque(0, _STEP) - torque(0, -_STEP)) / (2 * _STEP)
            by_v = (torque(1, 1.0) - torque(1, -1.0)) / 2
            by_q, by_v, by_a = map(
                np.asfortranarray, (by_q, by_v, torque(2, 1.0) - self.load)
            )
            self._known_slopes[j] = by_q, by_v, by_a
        return self._known_slopes[j]

    def between(self, j: int, count: int) -> Array:
        """A joint's load and its slopes by its own q, v and a at more instants.

        Cubics go through the samples, those of the last joint are kept.

        Returns:
            Values at the parts of each sample, shape (4, count · (N − 1) + 1).
        """
        if self._cubics[0] != j:
            from scipy.interpolate import CubicSpline

            known = self.load, *self.slopes(j)
            signals = np.stack([x[:, j] for x in known], axis=1)
            cubics = CubicSpline(np.arange(len(signals)), signals).c.T  # (4, N − 1, 4)
            last = np.zeros((4, 1, 4))
            last[:, 0, 3] = signals[-1]
            self._cubics = j, np.concatenate([cubics, last], axis=1)
        # All instants are at the same parts of a sample: no search is needed.
        powers, cubics = np.vander(np.arange(count) / count, 4), self._cubics[1]
        instants = count * (cubics.shape[1] - 1) + 1
        return np.asarray((cubics @ powers.T).reshape(4, -1)[:, :instants])

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity in the base frame, shape (3,), [m/s²]."""
        return self.chain.gravity

    def weight(self, gravity: Array) -> Array:
        """Torque that holds the links at rest in a gravity, shape (N, n), [N·m]."""
        rest = np.zeros_like(self.motion.q)
        chain = replace(self.chain, gravity=gravity)
        return inverse_dynamics(chain, self.inertial, self.motion.q, rest, rest)

    def wrench_columns(self, link: int) -> Array:
        """Transposed Jacobian: drive torque per force and moment that a link exerts.

        Returns:
            Torque, shape (N, n, 6), per force [N] and moment [N·m] along the axes of
            the base frame, about the origin of the link's frame.
        """
        if link not in self._known_wrenches:
            _, origins, axes = frames(self.chain, self.motion.q)
            columns = np.zeros((*self.motion.q.shape, 6))
            for j in range(link + 1):
                if self.chain.revolute[j]:
                    columns[:, j, :3] = np.cross(axes[j], origins[link] - origins[j])
                    columns[:, j, 3:] = axes[j]
                else:
                    columns[:, j, :3] = axes[j]
            self._known_wrenches[link] = columns
        return self._known_wrenches[link]

    def _torque(self, q: Array, v: Array, a: Array) -> Array:
        return inverse_dynamics(self.chain, self.inertial, q, v, a)


def simulated_torque(robot: Robot, motion: Motion, body: RigidBody) -> Array:
    """Drive torque that the simulator needs along a motion, shape (N, n), [N·m]."""
    return (
        body.load
        + robot.joint_torque(motion.q, motion.v, motion.a)
        + robot.dry_friction(motion.v)
    )
