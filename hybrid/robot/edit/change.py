"""Changes to be made in a robot file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from operator import add, mul
from typing import TYPE_CHECKING, Any

from hybrid.robot.robot import Robot

if TYPE_CHECKING:
    import mujoco

# Changes of an actuator -> how two of one kind combine.
_BOTH: Mapping[str, Callable[[float, float], float]] = {
    "gain": mul, "lag": add, "limit": min, "latency": add, "stiffness": mul,
    "damping": mul,
}  # fmt: skip
Structure = Callable[["mujoco.MjSpec", Sequence[str]], Any]


@dataclass(frozen=True)
class Actuator:
    """Changes of an actuator; torques are those at the joint.

    Attributes:
        gain: Factor of the commanded torque.
        lag: Time constant of the torque, [s].
        limit: Largest torque, [N·m].
        latency: Delay of commands, [s].
        stiffness: Factor of the stiffness of a position servo.
        damping: Factor of the damping of a position servo.
    """

    gain: float = 1.0
    lag: float = 0.0
    limit: float = inf
    latency: float = 0.0
    stiffness: float = 1.0
    damping: float = 1.0

    def and_then(self, other: Mapping[str, float]) -> Actuator:
        """Combine with further changes, given by name."""
        both = {name: (getattr(self, name), x) for name, x in other.items()}
        return replace(self, **{name: _BOTH[name](*x) for name, x in both.items()})


@dataclass(frozen=True)
class Edit:
    """Changes of a robot file.

    Attributes:
        robot: The arm with new links, gravity, rotors, friction and springs.
        drives: Changes of actuators by index of the joint.
        structure: Functions that add joints, tendons or constraints to a spec.
    """

    robot: Robot
    drives: Mapping[int, Actuator] = field(default_factory=dict)
    structure: Sequence[Structure] = ()
