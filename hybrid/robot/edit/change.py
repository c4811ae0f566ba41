"""The changes to make in a robot file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hybrid.robot.edit.actuator import Actuator
from hybrid.robot.robot import Robot

if TYPE_CHECKING:
    import mujoco

Structure = Callable[["mujoco.MjSpec", Sequence[str]], Any]


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
