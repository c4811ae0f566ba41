"""What a robot file declares of its joints, as effects."""

from __future__ import annotations

from hybrid.effects import Effect
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.nonlinear_viscous import NonlinearViscous
from hybrid.effects.spring import Spring
from hybrid.effects.viscous import Viscous
from hybrid.robot import Robot


def declared_effects(robot: Robot) -> list[Effect]:
    """Rotors, friction and springs of a robot file, where it has them."""
    found: list[Effect] = []
    for j in range(robot.size):
        stiffness = robot.stiffness[j]
        values: dict[type[Effect], dict[str, float]] = {
            Armature: {"inertia": robot.chain.armature[j]},
            Viscous: {"coefficient": robot.damping[j]},
            Coulomb: {"level": robot.frictionloss[j]},
            NonlinearViscous: {
                "quadratic": robot.quadratic[j],
                "cubic": robot.cubic[j],
            },
            Spring: {
                "stiffness": stiffness,
                "preload": -stiffness * robot.springref[j],
            },
        }
        for cls, own in values.items():
            if any(own.values()):
                found.append(cls((j,), {name: float(x) for name, x in own.items()}))
    return found
