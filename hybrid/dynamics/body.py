"""Rigid-body quantities along one motion, as far as effects need them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hybrid.dynamics.regressor import inverse_dynamics, regressor
from hybrid.robot.chain import Array, Chain
from hybrid.signals import Motion


class RigidBody:
    """The arm's rigid body along a motion; each quantity is worked out once.

    Args:
        chain: The arm.
        motion: N samples of its motion.
        inertial: Link parameters to use, shape (n, 10); the chain's own by default.
            Any set with the right base parameters gives the right torque.
    """

    def __init__(
        self, chain: Chain, motion: Motion, inertial: Array | None = None
    ) -> None:
        self.chain = chain
        self.motion = motion
        self.inertial = chain.inertial if inertial is None else inertial

    @cached_property
    def load(self) -> Array:
        """Torque transmitted to the links, shape (N, n), [N·m]."""
        return self._torque(self.motion.q, self.motion.v, self.motion.a)

    @cached_property
    def columns(self) -> Array:
        """Regressor of all links, shape (N, n, 10n)."""
        return regressor(self.chain, self.motion.q, self.motion.v, self.motion.a)

    def link_columns(self, link: int) -> Array:
        """Torque per inertial parameter of one link, shape (N, n, 10)."""
        return self.columns[:, :, 10 * link : 10 * link + 10]

    def response(self, dq: Array, dv: Array, da: Array) -> Array:
        """Change of rigid torque along a change of motion, shape (N, n), [N·m].

        Central difference of the inverse dynamics, scaled so that the step is small
        against a radian whatever the size of the change.

        Args:
            dq: Change of position, shape (N, n), [rad].
            dv: Change of speed, shape (N, n), [rad/s].
            da: Change of acceleration, shape (N, n), [rad/s²].
        """
        m = self.motion
        size = max(float(np.abs(x).max(initial=1e-12)) for x in (dq, dv, da))
        step = 1e-4 / size
        ahead = self._torque(m.q + step * dq, m.v + step * dv, m.a + step * da)
        behind = self._torque(m.q - step * dq, m.v - step * dv, m.a - step * da)
        return (ahead - behind) / (2 * step)

    def _torque(self, q: Array, v: Array, a: Array) -> Array:
        return inverse_dynamics(self.chain, self.inertial, q, v, a)
