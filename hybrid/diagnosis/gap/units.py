"""Units at revolute and at prismatic joints."""

from collections.abc import Sequence

from hybrid.robot import Robot

# Unit at a revolute joint -> unit at a prismatic joint.
_PRISMATIC = (("kg·m²", "kg"), ("(N·m)", "N"), ("N·m", "N"), ("rad", "m"))


def units(robot: Robot, joints: Sequence[int]) -> tuple[str, str]:
    """Units of position and torque: m and N if all joints are prismatic.

    Otherwise they are rad and N·m, also for both kinds of joints together.
    """
    if len(joints) and not any(robot.chain.revolute[j] for j in joints):
        return "m", "N"
    return "rad", "N·m"


def unit_at(robot: Robot, joints: Sequence[int], unit: str) -> str:
    """Convert a unit that is stated for revolute joints to that of some joints."""
    if units(robot, joints) == ("m", "N"):
        for revolute, prismatic in _PRISMATIC:
            unit = unit.replace(revolute, prismatic)
    return unit
