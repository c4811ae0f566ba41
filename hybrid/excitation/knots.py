"""Motions through knots, from which ready-made experiments are built."""

import numpy as np

from hybrid.arrays import Array
from hybrid.excitation.constraints import Limits
from hybrid.excitation.path import quintic, uniform
from hybrid.plant.reference import Reference

_QUINTIC_SPEED, _QUINTIC_ACCELERATION = 1.875, 5.7735  # peaks of a unit move


class Walk:
    """A sequence of knots from a pose at rest, joined by quintic polynomials.

    Args:
        home: The first pose, shape (n,), [rad].
    """

    def __init__(self, home: Array) -> None:
        self._t, self._q = [0.0], [np.array(home, dtype=float)]
        self._v = [np.zeros(len(home))]

    def reference(self, rate: float) -> Reference:
        """Samples of the motion so far; acceleration is zero at every knot."""
        q, v = np.array(self._q), np.array(self._v)
        curve = quintic(np.array(self._t), q, v, np.zeros_like(q))
        t = uniform(self._t[-1], rate)
        return Reference(t, *(np.asarray(curve(t, nu=k)) for k in range(3)))

    def wait(self, duration: float) -> None:
        """Stand still for a time, [s]."""
        self._add(duration, self._q[-1], np.zeros_like(self._q[-1]))

    def go(self, goal: Array, duration: float) -> None:
        """Move to a pose and stop, in a given time, [s]."""
        self._add(duration, goal, np.zeros_like(goal))

    def move(self, goal: Array, limits: Limits) -> None:
        """Move to a pose and stop, with half of the limits."""
        distance = np.abs(goal - self._q[-1])
        if distance.max() < 1e-12:
            return
        by_speed = _QUINTIC_SPEED * distance / (0.5 * limits.speed)
        by_acceleration = np.sqrt(
            _QUINTIC_ACCELERATION * distance / (0.5 * limits.usable_acceleration)
        )
        self.go(goal, float(max(by_speed.max(), by_acceleration.max(), 0.1)))

    def cruise(self, joint: int, speed: float, ramp: float, duration: float) -> None:
        """Accelerate one joint, keep its speed, and stop."""
        for time, way, v in (
            (ramp, 0.5 * ramp, 1.0),
            (duration, duration, 1.0),
            (ramp, 0.5 * ramp, 0.0),
        ):
            q = self._q[-1].copy()
            rest = np.zeros_like(q)
            q[joint] += way * speed
            rest[joint] = v * speed
            self._add(time, q, rest)

    def _add(self, duration: float, q: Array, v: Array) -> None:
        self._t.append(self._t[-1] + duration)
        self._q.append(q)
        self._v.append(v)
