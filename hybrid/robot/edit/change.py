"""The changes to make in a robot file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Any

from hybrid.robot.robot import Robot

if TYPE_CHECKING:
    import mujoco

Structure = Callable[["mujoco.MjSpec", Sequence[str]], Any]


@dataclass(frozen=True)
class Actuator:
    """Changes of an actuator, at the joint.

    Attributes:
        gain: Factor of the torque that it is asked for.
        lag: Time constant with which its torque follows, [s].
        limit: Largest torque, [N·m].
        latency: By how much commands act later, [s].
        stiffness: Factor of the stiffness of a position servo.
        damping: Factor of its damping.
    """

    gain: float = 1.0
    lag: float = 0.0
    limit: float = inf
    latency: float = 0.0
    stiffness: float = 1.0
    damping: float = 1.0

    def and_then(self, other: Mapping[str, float]) -> Actuator:
        """Combine with further changes, given by name."""
        new = {}
        for name, x in other.items():
            own = getattr(self, name)
            if name == "limit":
                new[name] = min(own, x)
            elif name in ("gain", "stiffness", "damping"):
                new[name] = own * x
            else:
                new[name] = own + x
        return replace(self, **new)


@dataclass(frozen=True)
class Edit:
    """The arm that the edited file must describe.

    Attributes:
        robot: Links, gravity, rotors, friction and springs; all else is the file's.
        drives: What is new of the actuators, by joint counted from 0.
        structure: What puts joints, tendons or constraints into a spec of the arm.
    """

    robot: Robot
    drives: Mapping[int, Actuator] = field(default_factory=dict)
    structure: Sequence[Structure] = ()
