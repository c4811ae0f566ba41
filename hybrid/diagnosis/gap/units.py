"""Units at joints that turn and at joints that slide."""

from __future__ import annotations

from collections.abc import Sequence

from hybrid.robot import Robot

# What is written for a joint that turns, as it is at one that slides.
_SLIDING = (("kg·m²", "kg"), ("(N·m)", "N"), ("N·m", "N"), ("rad", "m"))


def units(robot: Robot, joints: Sequence[int]) -> tuple[str, str]:
    """Units of place and force: m and N if all of some joints slide, else rad and N·m.

    Of both kinds together figures are of mixed units, and go by the turning ones.
    """
    if len(joints) and not any(robot.chain.revolute[j] for j in joints):
        return "m", "N"
    return "rad", "N·m"


def unit_at(robot: Robot, joints: Sequence[int], unit: str) -> str:
    """A unit that is stated for joints that turn, at some joints."""
    if units(robot, joints) == ("m", "N"):
        for turning, sliding in _SLIDING:
            unit = unit.replace(turning, sliding)
    return unit
