"""Numbers of the simulator's file that effects are changes of."""

from __future__ import annotations

from dataclasses import dataclass

from hybrid.arrays import Array


@dataclass(frozen=True, eq=False)
class Nominal:
    """What a file says of an arm of n joints.

    Attributes:
        inertial: Parameters of each link, shape (n, 10).
        size: Size of each of these, by which an error of it is meant, shape (n, 10).
        armature: Rotor inertia of each joint, shape (n,), [kg·m²].
        damping: Viscous friction, shape (n,), [N·m·s/rad].
        frictionloss: Dry friction, shape (n,), [N·m].
    """

    inertial: Array
    size: Array
    armature: Array
    damping: Array
    frictionloss: Array
