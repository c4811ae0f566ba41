"""The controller: feed-forward of the nominal arm and PD on the motors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hybrid.arrays import Array
from hybrid.errors import HybridError
from hybrid.plant.arm import Arm, inverse_dynamics
from hybrid.plant.noise import rated_torque
from hybrid.plant.reference import Reference
from hybrid.robot.robot import Robot

# Largest damping times period over inertia; a sampled servo is unstable at 2.
_LARGEST_STEP = 1.0
# The servo is so stiff that usual friction, a share of the rated torque, causes at most
# this angle. Gains from inertia alone would be too low for wrists without rotors.
_FRICTION, _FRICTION_ANGLE = 0.05, 0.02  # 1, rad
_FREQUENCY, _DAMPING = 8.0, 1.0  # Hz; 1, of the natural motion
_POSTURES, _COUPLED_POSTURES = 20, 200


@dataclass(frozen=True, eq=False)
class Servo:
    """Feed-forward and PD controller of n joints, saturated, held between samples.

    It reads the motors' own encoders, which are finer than what is logged.

    Attributes:
        kp: Stiffness, shape (n,), [N·m/rad].
        kd: Damping, shape (n,), [N·m·s/rad].
        limit: Largest torque, shape (n,), [N·m]; inf for none.
        feedforward: Arm whose inverse dynamics along the reference is added, or None.
    """

    kp: Array
    kd: Array
    limit: Array
    feedforward: Robot | None = None

    def __post_init__(self) -> None:
        for name in ("kp", "kd", "limit"):
            x = np.asarray(getattr(self, name), dtype=float)
            if x.shape != np.shape(self.kp) or x.ndim != 1 or not (x >= 0).all():
                raise HybridError(f"servo {name} needs one value, 0 or above, a joint")
            object.__setattr__(self, name, x)

    @classmethod
    def tuned(cls, arm: Arm, robot: Robot, *, period: float, lag: Array) -> Servo:
        """Gains for a natural frequency at each joint's largest inertia, or higher.

        They are higher where usual friction would stop the joint, and low enough for
        the rotor alone, since the motor of an elastic joint moves without its link.
        ``robot`` is the arm that the controller knows, ``period`` its sampling time,
        [s], and ``lag`` the time constant of the drives, shape (n,), [s].
        """
        # With a lag T the loop is unstable unless kd > T·kp; half of that is used.
        fastest = _DAMPING / np.maximum(lag, 1e-9)
        wanted = np.minimum(2 * np.pi * _FREQUENCY, fastest)
        coupled, decoupled = _motor_inertia(arm)
        stable = _LARGEST_STEP * decoupled / (2 * _DAMPING * period)  # omega · inertia
        inertia = np.minimum(coupled, stable / wanted)
        stiff = _FRICTION / _FRICTION_ANGLE * rated_torque(robot)
        omega = np.maximum(wanted, np.sqrt(stiff / inertia))
        omega = np.minimum(np.minimum(omega, stable / inertia), fastest)
        # A servo that is slow because of the lag must be stiff enough as well.
        inertia = np.minimum(np.maximum(inertia, stiff / omega**2), stable / omega)
        decay = _fastest_decay(arm, 2 * _DAMPING * omega * inertia)
        inertia *= min(1.0, _LARGEST_STEP / (decay * period))
        return cls(
            kp=omega**2 * inertia,
            kd=2 * _DAMPING * omega * inertia,
            limit=robot.tau_max,
            feedforward=robot,
        )

    def plan(self, reference: Reference, t: Array) -> tuple[Array, Array, Array]:
        """Position [rad], speed [rad/s] and feed-forward torque [N·m] at given times.

        The arm waits at the ends of the reference. Times have the shape (M,), [s], and
        the results (M, n).
        """
        q, v = reference.at(t)
        if self.feedforward is None:
            return q, v, np.zeros_like(q)
        r = reference
        torque = inverse_dynamics(self.feedforward, r.q, r.v, r.a)
        columns = [np.interp(t, reference.t, column) for column in torque.T]
        return q, v, np.stack(columns, axis=1)


def _motor_inertia(arm: Arm) -> tuple[Array, Array]:
    """Largest inertia of each motor with other joints held, smallest with them free.

    Both are over random postures, shape (n,), [kg·m²].
    """
    masses = _masses(arm, _POSTURES)
    held = [M.diagonal()[arm.motor] for M in masses]
    free = [1.0 / np.linalg.inv(M).diagonal()[arm.motor] for M in masses]
    return np.max(held, axis=0), np.min(free, axis=0)


def _fastest_decay(arm: Arm, kd: Array) -> float:
    """Fastest decay that the damping gives to any motion of all joints, [1/s]."""
    motors, root = np.ix_(arm.motor, arm.motor), np.sqrt(kd)
    masses = _masses(arm, _COUPLED_POSTURES)
    mobility = np.array([np.linalg.inv(M)[motors] for M in masses])
    return float(np.linalg.eigvalsh(root[:, None] * mobility * root).max())


def _masses(arm: Arm, postures: int) -> Array:
    """Mass matrices of all degrees of freedom, shape (P, m, m), [kg·m²]."""
    model: Any = arm.model
    data = mujoco.MjData(model)
    full = np.zeros((postures, model.nv, model.nv))
    rng = np.random.default_rng(0)
    for M in full:
        data.qpos[arm.motor] = rng.uniform(-np.pi, np.pi, len(arm.motor))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
    return full
