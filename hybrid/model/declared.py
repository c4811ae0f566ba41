"""Effects that a robot file declares."""

from hybrid.effects import Effect
from hybrid.plant.joint_fields import couplings, curves, effects_of_fields
from hybrid.robot import Robot


def declared_effects(robot: Robot) -> list[Effect]:
    """Rotors, couplings, friction, ripple and springs of a robot file as effects."""
    names = "damping", "frictionloss", "quadratic", "cubic", "stiffness"
    values = {name: getattr(robot, name) for name in names}
    values["armature"] = robot.chain.armature
    values["preload"] = -robot.stiffness * robot.springref
    return [*effects_of_fields(values), *curves(robot), *couplings(robot.coupled)]
