"""Sensor noise of a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.plant.arm import inverse_dynamics
from hybrid.robot.robot import Robot

# See `Noise.typical`.
_TORQUE_FRACTION, _NEIGHBOUR_CORRELATION = 0.005, 0.4  # of the rated torque; 1
_ENCODER_BITS = 19  # per turn
_SPEED_STD = 1e-3  # rad/s


@dataclass(frozen=True, eq=False)
class Noise:
    """Sensor noise of an arm of n joints.

    Attributes:
        torque_covariance: Covariance of the torque noise between joints, shape
            (n, n), [(N·m)²].
        position_resolution: Encoder step, shape (n,), [rad]; 0 for none.
        position_std: Standard deviation of white position noise before the encoder
            rounds, shape (n,), [rad].
        speed_std: Standard deviation of white speed noise, shape (n,), [rad/s].
        correlation_time: Time constant of the torque noise (first order), [s]; 0 for
            white noise.

    Raises:
        HybridError: Shapes disagree, or the covariance is not symmetric and positive
            semidefinite.
    """

    torque_covariance: Array
    position_resolution: Array
    position_std: Array
    speed_std: Array
    correlation_time: float = 0.002

    def __post_init__(self) -> None:
        covariance = np.asarray(self.torque_covariance, dtype=float)
        n = len(covariance)
        if covariance.shape != (n, n) or not np.isfinite(covariance).all():
            raise HybridError("the torque covariance needs a finite (n, n) matrix")
        size = np.abs(covariance).max(initial=0.0)
        if (
            not np.allclose(covariance, covariance.T, atol=1e-9 * size)
            or np.linalg.eigvalsh(covariance).min(initial=0.0) < -1e-9 * size
        ):
            raise HybridError(
                "the torque covariance must be symmetric and positive semidefinite"
            )
        object.__setattr__(self, "torque_covariance", covariance)
        for name in ("position_resolution", "position_std", "speed_std"):
            x = np.asarray(getattr(self, name), dtype=float)
            if x.shape != (n,) or not (np.isfinite(x) & (x >= 0)).all():
                raise HybridError(f"{name} needs {n} values, 0 or above")
            object.__setattr__(self, name, x)
        if not (np.isfinite(self.correlation_time) and self.correlation_time >= 0):
            raise HybridError("correlation_time is 0 s or above")

    @classmethod
    def none(cls, size: int) -> Noise:
        """Perfect sensors for an arm of ``size`` joints."""
        zero = np.zeros(size)
        return cls(np.zeros((size, size)), zero, zero, zero)

    @classmethod
    def typical(cls, robot: Robot) -> Noise:
        """Noise of a common industrial arm.

        Torque noise of 0.5 % of rated torque, correlated 0.4 between neighbours and
        0.4ᵏ over k joints; a 19-bit encoder; speed noise of 1 mrad/s.
        """
        n, std = robot.size, _TORQUE_FRACTION * rated_torque(robot)
        distance = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        return cls(
            torque_covariance=np.outer(std, std) * _NEIGHBOUR_CORRELATION**distance,
            position_resolution=np.full(n, 2 * np.pi / 2**_ENCODER_BITS),
            position_std=np.zeros(n),
            speed_std=np.full(n, _SPEED_STD),
        )

    def apply(
        self, signals: dict[str, Array], *, rate: float, rng: np.random.Generator
    ) -> dict[str, Array]:
        """Noisy signals from the true ``q``, ``v`` and ``tau``, shape (N, n) each.

        They have a rate, in samples per second, [Hz].
        """
        shape = signals["q"].shape
        q = signals["q"] + self.position_std * rng.standard_normal(shape)
        step = np.where(self.position_resolution > 0, self.position_resolution, 1.0)
        q = np.where(self.position_resolution > 0, np.round(q / step) * step, q)
        v = signals["v"] + self.speed_std * rng.standard_normal(shape)
        tau = signals["tau"] + self._torque(shape[0], rate, rng)
        return signals | {"q": q, "v": v, "tau": tau}

    def _torque(self, samples: int, rate: float, rng: np.random.Generator) -> Array:
        """Stationary torque noise from its first sample on, shape (N, n), [N·m]."""
        from scipy.signal import lfilter

        size, axes = np.linalg.eigh(self.torque_covariance)
        root = axes * np.sqrt(np.clip(size, 0.0, None))
        white: Array = rng.standard_normal((samples, len(size))) @ root.T
        if self.correlation_time == 0:
            return white
        memory = float(np.exp(-1.0 / (rate * self.correlation_time)))
        fresh = np.sqrt(1.0 - memory**2) * white
        fresh[0] = white[0]
        coloured: Array = lfilter([1.0], [1.0, -memory], fresh, axis=0)
        return coloured


def rated_torque(robot: Robot) -> Array:
    """Rated torque of every joint, shape (n,), [N·m].

    Without one in the robot file: twice the largest gravity torque over a hundred
    postures, and at least 1 N·m.
    """
    if np.isfinite(robot.tau_max).all():
        return robot.tau_max
    postures = np.random.default_rng(0).uniform(-np.pi, np.pi, (100, robot.size))
    rest = np.zeros_like(postures)
    weight = inverse_dynamics(robot, postures, rest, rest)
    peak = np.maximum(2 * np.abs(weight).max(axis=0), 1.0)
    return np.where(np.isfinite(robot.tau_max), robot.tau_max, peak)
