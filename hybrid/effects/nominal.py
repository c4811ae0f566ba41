"""Parameters of the robot file that effects change."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.arrays import Array


@dataclass(frozen=True, eq=False)
class Nominal:
    """Parameters of an arm of n joints in its file.

    Attributes:
        inertial: Parameters of each link, shape (n, 10).
        size: Magnitude of each of them, the unit of its error, shape (n, 10).
        armature: Rotor inertia of each joint, shape (n,), [kg·m²].
        damping: Viscous friction, shape (n,), [N·m·s/rad].
        frictionloss: Dry friction, shape (n,), [N·m].
    """

    inertial: Array
    size: Array
    armature: Array
    damping: Array
    frictionloss: Array
