"""Limits of a motion: position, speed, acceleration, jerk and torque."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.dynamics import inverse_dynamics, torque_gradient
from hybrid.errors import ExcitationError
from hybrid.excitation.observation import TURNING_SPEED
from hybrid.excitation.path import Path
from hybrid.plant.reference import DEFAULT_ACCELERATION, limits
from hybrid.robot.robot import Robot


class Constraint(Protocol):
    """K conditions on each sample of a motion."""

    is_linear: ClassVar[bool] = False

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each condition, for messages, length K."""

    def excess(self, path: Path) -> Array:
        """Excess over the limit, relative to the limit, shape (N, K).

        It is zero at the limit and positive if the condition is violated.
        """

    def slope(self, path: Path, which: Index) -> Array:
        """Derivative of the excess of one condition in each sample, shape (N, 4, n).

        It is by position, speed, acceleration and jerk; ``which`` has the shape (N,).
        """


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the joints of an arm; infinite without a limit.

    Attributes:
        low: Lowest position, shape (n,), [rad].
        high: Highest position, shape (n,), [rad].
        speed: Highest speed, shape (n,), [rad/s].
        acceleration: Highest acceleration, shape (n,), [rad/s²].
        torque: Highest drive torque, shape (n,), [N·m].
        jerk: Highest jerk, shape (n,), [rad/s³].
    """

    low: Array
    high: Array
    speed: Array
    acceleration: Array
    torque: Array
    jerk: Array

    def __post_init__(self) -> None:
        for f in fields(self):
            x = np.asarray(getattr(self, f.name), dtype=float)
            object.__setattr__(self, f.name, x)
            if x.shape != np.shape(self.low) or x.ndim != 1 or np.isnan(x).any():
                raise ExcitationError(
                    f"limits: {f.name} needs one value for each joint"
                )
            if f.name not in ("low", "high") and (x <= 0).any():
                raise ExcitationError(f"limits: {f.name} must be above 0")
        if not (self.low < self.high).all():
            raise ExcitationError("limits: low must be below high for each joint")
        if not np.isfinite([self.low, self.high, self.speed]).all():
            raise ExcitationError("limits: positions and speeds must be finite")

    @property
    def usable_acceleration(self) -> Array:
        """Highest acceleration, or a default without a limit, shape (n,), [rad/s²]."""
        limited = np.isfinite(self.acceleration)
        return np.where(limited, self.acceleration, DEFAULT_ACCELERATION)

    @property
    def middle(self) -> Array:
        """Middle of each joint's range, shape (n,), [rad]."""
        return np.asarray((self.low + self.high) / 2)

    @property
    def sizes(self) -> Array:
        """Half the range, speed, acceleration and jerk, shape (4, n)."""
        half = (self.high - self.low) / 2
        return np.stack([half, self.speed, self.acceleration, self.jerk])

    @classmethod
    def of(cls, robot: Robot, *, fill: float = 0.8, jerk: float = np.inf) -> Limits:
        """A share of the robot file's limits, about the middle of each range.

        Args:
            robot: The arm. Missing limits are ±π rad and 2 rad/s, and 10 rad/s² if the
                torque has no limit either.
            fill: Share of the limits to use, above 0 up to 1.
            jerk: Highest jerk of all joints, [rad/s³].
        """
        if not 0 < fill <= 1:
            raise ExcitationError(f"fill is {fill:g}, above 0 up to 1 is valid")
        low, high, speed, _ = limits(robot)
        middle, half = (low + high) / 2, fill * (high - low) / 2
        unlimited = ~np.isfinite(robot.a_max) & ~np.isfinite(robot.tau_max)
        acceleration = np.where(unlimited, DEFAULT_ACCELERATION, robot.a_max)
        return cls(
            low=middle - half,
            high=middle + half,
            speed=fill * speed,
            acceleration=fill * acceleration,
            torque=fill * robot.tau_max,
            jerk=np.full(robot.size, jerk),
        )


@dataclass(frozen=True, eq=False)
class MotionLimits(Constraint):
    """Position, speed, acceleration and jerk of every joint."""

    is_linear: ClassVar[bool] = True

    limits: Limits
    joints: tuple[str, ...]

    @cached_property
    def _rows(self) -> tuple[Array, ...]:
        """Derivative, joint, sign, size and middle of each condition, shape (K,)."""
        limited = np.argwhere(np.isfinite(self.limits.sizes))
        derivative, joint = np.repeat(limited, 2, axis=0).T
        middle = np.where(derivative == 0, self.limits.middle[joint], 0.0)
        sign, size = np.tile([-1.0, 1.0], len(limited)), self.limits.sizes
        return derivative, joint, sign, size[derivative, joint], middle

    @property
    def names(self) -> tuple[str, ...]:
        """See :class:`Constraint`."""
        kinds = ("position", "speed", "acceleration", "jerk")
        derivative, joint, sign, _, _ = self._rows
        return tuple(
            f"{'lowest' if s < 0 else 'highest'} {kinds[k]} of {self.joints[j]}"
            for k, j, s in zip(derivative, joint, sign, strict=True)
        )

    def excess(self, path: Path) -> Array:
        """See :class:`Constraint`."""
        derivative, joint, sign, size, middle = self._rows
        x = np.stack([path.q, path.v, path.a, path.jerk])[derivative, :, joint].T
        return np.asarray(sign * (x - middle) / size - 1.0)

    def slope(self, path: Path, which: Index) -> Array:
        """See :class:`Constraint`."""
        derivative, joint, sign, size, _ = self._rows
        out = np.zeros((len(which), 4, len(self.joints)))
        at = np.arange(len(which)), derivative[which], joint[which]
        out[at] = (sign / size)[which]
        return out


@dataclass(frozen=True, eq=False)
class TorqueLimits(Constraint):
    """Torque of the nominal arm: rigid body, rotors and friction of its file.

    The highest torque ``limit`` has the shape (n,), [N·m].
    """

    robot: Robot
    limit: Array

    @cached_property
    def _rows(self) -> tuple[Index, Array]:
        """Joint and sign of each condition, shape (K,)."""
        limited = np.flatnonzero(np.isfinite(self.limit))
        return np.repeat(limited, 2), np.tile([-1.0, 1.0], len(limited))

    @property
    def names(self) -> tuple[str, ...]:
        """See :class:`Constraint`."""
        return tuple(
            f"{'lowest' if sign < 0 else 'highest'} torque of {self.robot.joints[j]}"
            for j, sign in zip(*self._rows, strict=True)
        )

    def torque(self, path: Path) -> Array:
        """Drive torque along a motion, shape (N, n), [N·m]."""
        robot, chain = self.robot, self.robot.chain
        tau = inverse_dynamics(chain, chain.inertial, path.q, path.v, path.a)
        tau += robot.joint_torque(path.q, path.v, path.a)
        return tau + robot.dry_friction(path.v, lambda v: np.tanh(v / TURNING_SPEED))

    def excess(self, path: Path) -> Array:
        """See :class:`Constraint`."""
        joint, sign = self._rows
        return np.asarray(sign * (self.torque(path) / self.limit)[:, joint] - 1.0)

    def slope(self, path: Path, which: Index) -> Array:
        """See :class:`Constraint`."""
        joint, sign = self._rows
        j, samples = joint[which], np.arange(len(which))
        robot, chain = self.robot, self.robot.chain
        by = torque_gradient(chain, path.q, path.v, path.a, chain.inertial, j)
        out = np.stack([*by, np.zeros_like(path.q)], axis=1)
        v = path.v[samples, j]
        speed, bend = np.abs(v), np.where(robot.knee > 0, robot.knee_speed, 1.0)[j]
        out[samples, 0, j] += robot.position_slope(path.q)[samples, j]
        out[samples, 1, j] += robot.damping[j] + 2 * robot.quadratic[j] * speed
        out[samples, 1, j] += 3 * robot.cubic[j] * speed**2
        out[samples, 1, j] += robot.frictionloss[j] * _turning(v) / TURNING_SPEED
        out[samples, 1, j] += np.where(speed < bend, robot.knee[j] / bend, 0.0)
        out[samples, 2, j] += chain.armature[j]
        for joint, height, slow in robot.falling:
            fall = height * np.exp(-((v / slow) ** 2)) * (j == int(joint))
            change = _turning(v) / TURNING_SPEED
            change -= 2 * v / slow**2 * np.tanh(v / TURNING_SPEED)
            out[samples, 1, j] += fall * change
        for first, second, inertia, damping, dry in robot.coupled:
            pair = [int(first), int(second)]
            own = np.isin(j, pair)[:, None]
            turning = _turning(path.v[:, pair].sum(axis=1))[:, None]
            out[:, 1, pair] += (damping + dry * turning / TURNING_SPEED) * own
            out[:, 2, pair] += inertia * own
        return np.asarray(out * (sign[which] / self.limit[j])[:, None, None])


def _turning(v: Array) -> Array:
    """Change of the direction of dry friction with speed, in turning speeds."""
    return np.asarray(1.0 / np.cosh(np.clip(v / TURNING_SPEED, -50, 50)) ** 2)
