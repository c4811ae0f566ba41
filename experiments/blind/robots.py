"""Arms of the benchmark: public robot files, made complete, and made a little wrong."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.armature import Armature
from hybrid.effects.coulomb import Coulomb
from hybrid.effects.viscous import Viscous
from hybrid.errors import HybridWarning
from hybrid.plant.scale import joint_scales
from hybrid.robot import Robot
from hybrid.robot.spatial import central_inertia, inertial_about


def load_arm(name: str) -> Robot:
    """A robot by file or name, complete.

    Args:
        name: As :meth:`hybrid.robot.robot.Robot.load` takes it.

    Raises:
        RobotError: There is no such file or arm.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HybridWarning)  # held fingers
        return complete(Robot.load(name))


def complete(robot: Robot) -> Robot:
    """The arm with usual rotors, damping or dry friction, where its file states none.

    Robot files often leave them out. Every plant has them, so that its gap would be
    theirs alone.
    """
    scales, chain = joint_scales(robot), robot.chain
    kinds = ((Armature, "inertia"), (Viscous, "coefficient"), (Coulomb, "level"))
    armature, damping, friction = (
        np.array([kind.typical((j,), scales).values[name] for j in range(robot.size)])
        for kind, name in kinds
    )
    return replace(
        robot,
        chain=chain if chain.armature.any() else replace(chain, armature=armature),
        damping=robot.damping if robot.damping.any() else damping,
        frictionloss=robot.frictionloss if robot.frictionloss.any() else friction,
    )


def off_by(robot: Robot, share: float, rng: np.random.Generator) -> Robot:
    """The real arm: each number of the file is off by up to a share, all physical.

    Args:
        robot: The arm as its file says.
        share: Largest relative error.
        rng: Source of the errors, uniform and independent.
    """

    def factor(*shape: int) -> Array:
        return np.asarray(1.0 + share * rng.uniform(-1.0, 1.0, shape))

    n, links = robot.size, robot.chain.inertial.copy()
    for k, link in enumerate(links):
        if link[0] > 0:
            mass, centre, about = central_inertia(link)
            links[k] = inertial_about(
                mass * float(factor()), centre * factor(3), about * float(factor())
            )
    real = robot.with_inertial(links)
    return replace(
        real,
        chain=replace(real.chain, armature=real.chain.armature * factor(n)),
        damping=real.damping * factor(n),
        frictionloss=real.frictionloss * factor(n),
    )
