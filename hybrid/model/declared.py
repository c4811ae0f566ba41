"""Effects that a robot file declares."""

from __future__ import annotations

from hybrid.effects import Effect
from hybrid.plant.joint_fields import (
    couplings,
    effects_of_fields,
    falls,
    knees,
    ripples,
)
from hybrid.robot import Robot


def declared_effects(robot: Robot) -> list[Effect]:
    """Rotors, couplings, friction, ripple and springs of a robot file as effects."""
    names = "damping", "frictionloss", "quadratic", "cubic", "stiffness"
    values = {name: getattr(robot, name) for name in names}
    values["armature"] = robot.chain.armature
    values["preload"] = -robot.stiffness * robot.springref
    curves = *knees(robot), *ripples(robot), *falls(robot), *couplings(robot)
    return [*effects_of_fields(values), *curves]
