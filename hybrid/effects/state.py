"""Inputs of laws: the state of one joint, the rigid body, and the robot file."""

from dataclasses import dataclass
from typing import Protocol

from hybrid.arrays import Array as Array


@dataclass(frozen=True)
class JointState:
    """State of one joint, the input of its law; arrays of one shape.

    Attributes:
        t: Time, [s].
        q: Position, [rad].
        v: Speed, [rad/s].
        a: Acceleration, [rad/s²].
        sign: Direction of motion, −1, 0 or 1; at rest, a plant passes that to come.
        load: Torque transmitted to the link, [N·m].
        temperature: Temperature of the drive, [°C]; None if it is not measured.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    sign: Array
    load: Array
    temperature: Array | None = None


@dataclass(frozen=True, eq=False)
class Nominal:
    """Parameters of an arm of n joints in its file.

    Attributes:
        inertial: Parameters of each link, shape (n, 10).
        size: Magnitude of each of them, the unit of its error, shape (n, 10).
        armature: Rotor inertia of each joint, shape (n,), [kg·m²].
        damping: Viscous friction, shape (n,), [N·m·s/rad].
        frictionloss: Dry friction, shape (n,), [N·m].
    """

    inertial: Array
    size: Array
    armature: Array
    damping: Array
    frictionloss: Array


class Body(Protocol):
    """Rigid-body quantities along a motion, as far as effects need them."""

    @property
    def load(self) -> Array:
        """Torque transmitted to the links, shape (N, n), [N·m]."""

    def link_columns(self, link: int) -> Array:
        """Torque per inertial parameter of one link, shape (N, n, 10)."""

    def slopes(self, j: int) -> tuple[Array, Array, Array]:
        """Derivatives of all torques by q, v and a of a joint, shape (N, n) each."""

    def between(self, j: int, count: int) -> Array:
        """A joint's load and slopes by its own q, v, a, (4, count · (N − 1) + 1)."""

    def response(self, j: int, dq: Array, dv: Array, da: Array) -> Array:
        """Change of rigid torque along a change of a joint's motion, (N, n), [N·m]."""

    @property
    def gravity(self) -> Array:
        """Acceleration of gravity in the base frame, shape (3,), [m/s²]."""

    def weight(self, gravity: Array) -> Array:
        """Torque that holds the links against a gravity, shape (N, n), [N·m]."""

    def wrench_columns(self, link: int) -> Array:
        """Torque per unit force and moment that a link exerts, shape (N, n, 6)."""
