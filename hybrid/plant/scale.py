"""Rated torque and speed of joints: the units of the usual sizes of effects."""

from hybrid.effects import Scale
from hybrid.plant.noise import rated_torque
from hybrid.plant.reference import limits
from hybrid.robot.robot import Robot


def joint_scales(robot: Robot) -> tuple[Scale, ...]:
    """Rated torque and speed of every joint, n of them.

    Without them in the robot file: from gravity, and a usual speed.
    """
    speed = limits(robot)[2]
    return tuple(
        Scale(float(torque), float(v))
        for torque, v in zip(rated_torque(robot), speed, strict=True)
    )
