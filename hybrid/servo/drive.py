"""A position servo at every joint, in the numbers that a simulator has for it.

    τ = clip(k (c(t − d) − q) − b_s q̇, ± τ_s) − (b − b_s) q̇ − f + τ₀

with command c, delay d, the servo's share b_s of damping b, and bristles (LuGre) for
the friction f:

    ż = q̇ − σ |q̇| z / g(q̇),   f = σ z + σ₁ ż,   g = F_c + (F_s − F_c) e^−(q̇/v_s)²

The servo ignores errors within a dead band; its goal moves by no more than a rad in the
time of the pace; stops are at ``lower`` and ``upper``; a spring holds the joint; the
link's mass is a multiple of the file's, and the axis may point the other way. A link is
a ball about its centre of mass where it touches the ground, at a height of the centre
that is to be found. Backlash
between a stiff motor and an encoder on the link shows as a dead band: motion does not
tell them apart.

Sources: Canudas de Wit et al. 1995, doi 10.1109/9.376053 (friction).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.errors import RobotError
from hybrid.robot import Robot

_FAR = 20.0  # logarithm of a number in SI units that no servo has
_PRESLIDING = 1e-3  # rad: how far bristles bend before a joint breaks loose, mostly
_FREE = 100.0  # rad: where the stops of a joint without stops are
_LITTLE = 1e-4  # of a torque: what stands for none where a logarithm is fitted


@dataclass(frozen=True)
class DriveQuantity:
    """One number of every servo, and what is known of it before a log is seen.

    Attributes:
        name: Standard term.
        unit: SI unit.
        effect: Effect of the library that a wrong value is.
        spread: Prior standard deviation: of the logarithm for a positive number, else
            in multiples of ``per``.
        per: ``torque`` for multiples of the stall torque; else plain SI.
        positive: Whether the number is above zero, and its logarithm is fitted.
        least: Smallest value. Of presliding it is what a step of the replay resolves:
            stiffer bristles are unstable.
        shared: Whether it moves other joints as much as its own.
        unsaid: Whether MJCF has no place for it.
    """

    name: str
    unit: str
    effect: str
    spread: float
    per: str = ""
    positive: bool = True
    least: float = -np.inf
    shared: bool = False
    unsaid: bool = False


QUANTITIES = (
    DriveQuantity("stiffness", "N·m/rad", "controller_gain", 2.0),
    DriveQuantity("damping", "N·m·s/rad", "viscous", 2.0),
    DriveQuantity("coulomb", "N·m", "coulomb", 2.0),
    DriveQuantity("stiction", "N·m", "stribeck", 0.05, "torque", False, 0.0),
    DriveQuantity("stribeck_speed", "rad/s", "stribeck", 1.0),
    DriveQuantity("presliding", "rad", "presliding", 2.0, least=3e-4),
    DriveQuantity("armature", "kg·m²", "armature", 2.0),
    DriveQuantity("stall", "N·m", "saturation", 1.0),
    DriveQuantity("offset", "N·m", "torque_offset", 0.05, "torque", False),
    DriveQuantity("zero", "rad", "encoder_offset", 0.05, "", False),
    DriveQuantity("delay", "s", "command_latency", 0.03, "", False, 0.0),
    DriveQuantity("spring", "N·m/rad", "spring", 0.3, "torque", False, 0.0),
    DriveQuantity("dead_band", "rad", "deadzone", 0.02, "", False, 0.0, unsaid=True),
    DriveQuantity("pace", "s/rad", "goal_speed", 1.0, "", False, 0.0, unsaid=True),
    DriveQuantity("lower", "rad", "contact", 0.5, "", False),
    DriveQuantity("upper", "rad", "contact", 0.5, "", False),
    DriveQuantity("mass", "", "payload", 0.3, shared=True),
    DriveQuantity("ground", "m", "contact", 0.2, "", False, shared=True),
    DriveQuantity("sign", "", "sign", 1.0, "", False, -1.0, shared=True),
)
NAMES = tuple(x.name for x in QUANTITIES)
PLAIN = ("stiffness", "damping", "coulomb", "armature", "offset", "delay")


@dataclass(frozen=True, eq=False)
class Drive:
    """Servos of an arm of n joints.

    Attributes:
        values: Value of each quantity, shape (len(QUANTITIES), n), in SI units.
        stall: Torque in which some spreads are stated, shape (n,), [N·m].
    """

    values: Array
    stall: Array

    def __getitem__(self, name: str) -> Array:
        """Values of one quantity, shape (n,)."""
        return np.asarray(self.values[NAMES.index(name)])

    def at(self, **changed: Any) -> Drive:
        """The same with other values of some quantities, (n,) or one for all."""
        values = self.values.copy()
        for name, x in changed.items():
            values[NAMES.index(name)] = x
        return replace(self, values=values)

    @property
    def bristle(self) -> Array:
        """Stiffness σ of a joint before it breaks loose, shape (n,), [N·m/rad]."""
        return np.asarray(self["coulomb"] / self["presliding"])

    @property
    def spread(self) -> Array:
        """Prior standard deviations of the coordinates, (len(QUANTITIES), n)."""
        ones = np.ones_like(self.stall)
        return np.array(
            [x.spread * (self.stall if x.per == "torque" else ones) for x in QUANTITIES]
        )

    @property
    def coordinates(self) -> Array:
        """What is fitted: logarithms of positive numbers, (len(QUANTITIES), n)."""
        rows = zip(QUANTITIES, self.values, strict=True)
        return np.array([np.log(x) if each.positive else x for each, x in rows])

    def moved(self, coordinates: Array) -> Drive:
        """Servos at other coordinates."""
        rows = zip(QUANTITIES, coordinates, strict=True)
        values = [
            np.maximum(np.exp(np.clip(x, -_FAR, _FAR)) if q.positive else x, q.least)
            for q, x in rows
        ]
        return replace(self, values=np.array(values))

    @classmethod
    def declared(cls, robot: Robot) -> Drive:
        """Servos as a robot file states them; usual ones where it states none.

        Args:
            robot: The arm.
        """
        n = robot.size
        stall = np.where(np.isfinite(robot.tau_max), robot.tau_max, _usual(robot))
        gain = np.where(np.isfinite(robot.kp), robot.kp, stall / 0.1)
        servo = np.where(np.isfinite(robot.kd), robot.kd, 0.0)
        little = _LITTLE * stall
        friction = np.maximum(robot.frictionloss, little)
        known = {
            "stiffness": gain,
            "damping": np.maximum(servo + robot.damping, little),
            "coulomb": friction,
            "stribeck_speed": np.full(n, 0.05),
            "presliding": np.full(n, _PRESLIDING),
            "armature": np.maximum(robot.chain.armature, 1e-4 * stall),
            "stall": stall,
            "lower": np.where(np.isfinite(robot.q_min), robot.q_min, -_FREE),
            "upper": np.where(np.isfinite(robot.q_max), robot.q_max, _FREE),
            "mass": np.ones(n),
            "ground": -_reach(robot),
            "sign": np.ones(n),
        }
        known["stiction"] = np.zeros(n)
        for j, level, speed in robot.falling:
            known["stiction"][int(j)], known["stribeck_speed"][int(j)] = level, speed
        values = [known.get(name, np.zeros(n)) for name in NAMES]
        return cls(np.array(values), stall)


def known_masses(robot: Robot, known: Mapping[str, float]) -> Array:
    """Masses of links over those of the file, shape (n,).

    A link whose mass is known has it; all others are off by as much, the geometric mean
    if several are known.

    Args:
        robot: The arm.
        known: Mass of the link that a joint moves, by the joint's name, [kg].

    Raises:
        RobotError: No joint has the name, or its link has no mass in the file.
    """
    ratio = np.full(robot.size, np.nan)
    for name, mass in known.items():
        if name not in robot.joints:
            raise RobotError(
                f"known mass: the arm has no joint {name!r}; valid are "
                + ", ".join(robot.joints)
            )
        j = robot.joints.index(name)
        file = float(robot.chain.inertial[j, 0])
        if not (np.isfinite(mass) and mass > 0 and file > 0):
            raise RobotError(
                f"known mass: {mass:g} kg behind {name!r}, where the file has "
                f"{file:g}; valid are masses above 0 of links that have one"
            )
        ratio[j] = mass / file
    told = np.isfinite(ratio)
    usual = np.exp(np.log(ratio[told]).mean()) if told.any() else 1.0
    return np.where(told, ratio, usual)


def _reach(robot: Robot) -> Array:
    """How far links' centres of mass get from the base at most, shape (n,), [m]."""
    chain = robot.chain
    ends = np.nan_to_num([robot.q_min, robot.q_max], posinf=0.0, neginf=0.0)
    slides = np.where(chain.revolute, 0.0, np.abs(ends).max(axis=0))
    joints = np.cumsum(np.linalg.norm(chain.translation, axis=1) + slides)
    return np.asarray(joints + np.linalg.norm(centres(robot), axis=1))


def centres(robot: Robot) -> Array:
    """Centre of mass of every link in its frame, shape (n, 3), [m]."""
    inertial = robot.chain.inertial
    return np.asarray(inertial[:, 1:4] / np.maximum(inertial[:, :1], 1e-12))


def _usual(robot: Robot) -> Array:
    """Stall torques that hold the arm against gravity with room, (n,), [N·m]."""
    chain = robot.chain
    reach = np.linalg.norm(chain.translation, axis=1)
    beyond = np.cumsum(reach[::-1])[::-1] + 0.1
    mass = np.cumsum(chain.inertial[::-1, 0])[::-1]
    return np.maximum(3.0 * 9.81 * mass * beyond, 0.1)
