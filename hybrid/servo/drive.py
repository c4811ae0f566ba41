"""The position servo of every joint, in the parameters of a simulator.

    τ = clip(k (c(t − d) − q) − b_s q̇, ± τ_s) − (b − b_s) q̇ − f + τ₀

with command c, delay d, damping b of which the servo has the share b_s, stall torque
τ_s, and friction f by the LuGre model, whose bristles bend by z:

    ż = q̇ − σ |q̇| z / g(q̇),   f = σ z + σ₁ ż,   g = F_c + (F_s − F_c) e^−(q̇/v_s)²

F_c grows by μ |τ − f| with the load. A curved damping c q̇|q̇| adds to b.

The servo ignores position errors within a dead band. Its goal takes at least a time
``pace`` for a rad. ``lower`` and ``upper`` are the stops of the joint. A spring pulls
the joint to its zero. ``mass`` is the mass of the link over that of the file. ``sign``
is −1 if the axis points the other way. ``ground`` is the height of a centre of mass
when the link touches the ground. Between motor and link a gear may have ``play``, half
its gap; the encoder, which the servo reads as well, is on the link. ``roll`` and
``pitch`` of the base stand at the first joint.

Sources: Canudas de Wit et al. 1995, doi 10.1109/9.376053 (friction); Nordin and Gutman
2002, doi 10.1016/S0005-1098(02)00047-X (backlash).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.effects.gravity_tilt import GravityTilt
from hybrid.errors import RobotError
from hybrid.plant.noise import rated_torque
from hybrid.robot import Robot
from hybrid.statistics import HALF_WIDTH

_FAR = 20.0  # logarithm of a value in SI units that no servo reaches
_PRESLIDING = 1e-3  # rad: usual bend of the bristles before a joint slides
_FREE = 100.0  # rad: stops of a joint whose file has none
_UNLIMITED = 1e4  # of the rated torque: that of a servo whose file has no limit
_LITTLE = 1e-4  # of the stall torque: stands for zero, which has no logarithm
# Columns of friction in a robot, after the joint.
_FALL = "stiction", "stribeck_speed"
_BRISTLE = "coulomb", *_FALL, "presliding"


@dataclass(frozen=True)
class DriveQuantity:
    """One parameter of a servo, and its prior."""

    name: str
    unit: str  # SI
    effect: str  # of the library, that is reported if the file has a wrong value
    # Prior standard deviation: of the logarithm if it is positive, else times ``per``.
    spread: float
    per: str = ""  # "torque": the stall torque; else plain SI
    positive: bool = False  # whether it is above zero; then its logarithm is fitted
    least: float = -np.inf  # a presliding below it is unstable in a replay
    shared: bool = False  # whether it moves other joints as much as its own
    base: bool = False  # whether it is one number of the arm, at the first joint
    unsaid: bool = False  # whether MJCF cannot express it
    alone: bool = False  # whether it is probed joint by joint: some may be unstable
    probe: float = 0.05  # finite difference over a fit's step; impacts need a long one

    def interval(self, value: float, std: float) -> tuple[float, float]:
        """The 95 % interval of a value with the standard deviation of a fit."""
        off = HALF_WIDTH * std
        if self.positive:
            return value * float(np.exp(-off)), value * float(np.exp(off))
        return max(value - off, self.least), value + off


QUANTITIES = (
    DriveQuantity("stiffness", "N·m/rad", "controller_gain", 2.0, positive=True),
    DriveQuantity("damping", "N·m·s/rad", "viscous", 2.0, positive=True),
    DriveQuantity("coulomb", "N·m", "coulomb", 2.0, positive=True),
    DriveQuantity("stiction", "N·m", "stribeck", 0.05, "torque", least=0.0),
    DriveQuantity("stribeck_speed", "rad/s", "stribeck", 1.0, positive=True),
    DriveQuantity("presliding", "rad", "presliding", 2.0, positive=True, least=3e-4),
    DriveQuantity("armature", "kg·m²", "armature", 2.0, positive=True),
    DriveQuantity("stall", "N·m", "saturation", 1.0, positive=True),
    DriveQuantity("offset", "N·m", "torque_offset", 0.05, "torque"),
    DriveQuantity("zero", "rad", "encoder_offset", 0.05),
    DriveQuantity("delay", "s", "command_latency", 0.03, least=0.0),
    DriveQuantity("spring", "N·m/rad", "spring", 0.3, "torque", least=0.0),
    DriveQuantity("dead_band", "rad", "deadzone", 0.02, least=0.0, unsaid=True),
    DriveQuantity(
        "play", "rad", "backlash", 0.02, least=0.0, unsaid=True, alone=True, probe=0.25
    ),
    DriveQuantity("load_friction", "", "load_friction", 0.1, least=0.0, unsaid=True),
    DriveQuantity(
        "quadratic", "N·m·s²/rad²", "nonlinear_viscous", 0.1, "torque", least=0.0
    ),
    DriveQuantity("pace", "s/rad", "goal_speed", 1.0, least=0.0, unsaid=True),
    DriveQuantity("lower", "rad", "contact", 0.5),
    DriveQuantity("upper", "rad", "contact", 0.5),
    DriveQuantity("mass", "", "payload", 0.3, positive=True, shared=True),
    DriveQuantity("roll", "rad", "gravity_tilt", 0.05, shared=True, base=True),
    DriveQuantity("pitch", "rad", "gravity_tilt", 0.05, shared=True, base=True),
    DriveQuantity("ground", "m", "contact", 0.2, shared=True),
    DriveQuantity("sign", "", "sign", 1.0, least=-1.0, shared=True),
)
NAMES = tuple(x.name for x in QUANTITIES)
LOGARITHMIC = np.array([[x.positive] for x in QUANTITIES])
_LEAST = np.array([[x.least] for x in QUANTITIES])
_SPREAD = np.array([[x.spread] for x in QUANTITIES])
_PER_TORQUE = np.array([[x.per == "torque"] for x in QUANTITIES])
PLAIN = ("stiffness", "damping", "coulomb", "armature", "offset", "delay")


@dataclass(frozen=True, eq=False)
class Drive:
    """Servo parameters of an arm of n joints.

    Attributes:
        values: Value of each quantity, shape (len(QUANTITIES), n), in SI units.
        stall: Stall torque of the file, or else the usual one, the unit of some priors,
            shape (n,), [N·m].
    """

    values: Array
    stall: Array

    def __getitem__(self, name: str) -> Array:
        """Values of one quantity, shape (n,)."""
        return np.asarray(self.values[NAMES.index(name)])

    def at(self, **changed: Any) -> Drive:
        """A copy with other values of some quantities, (n,) or scalars."""
        values = self.values.copy()
        for name, x in changed.items():
            values[NAMES.index(name)] = x
        return replace(self, values=values)

    @property
    def tilt(self) -> GravityTilt:
        """Tilt of the base."""
        angles = {name: float(self[name][0]) for name in ("roll", "pitch")}
        return GravityTilt(tuple(range(self.stall.size)), angles)

    @property
    def plays(self) -> Mask:
        """Whether the gear of each joint has play, shape (n,)."""
        return np.asarray(self["play"] > 0)

    @property
    def layout(self) -> bytes:
        """The values that need a compiled model of their own."""
        tilt = self["roll"][0], self["pitch"][0]
        return bytes(np.r_[self["zero"], self["sign"], self.plays, tilt])

    @property
    def unlimited(self) -> Mask:
        """Whether the torque of each servo has no limit, shape (n,)."""
        return np.asarray(self["stall"] > 0.5 * _UNLIMITED * self.stall)

    @property
    def bristle(self) -> Array:
        """Stiffness σ of the bristles, shape (n,), [N·m/rad]."""
        return np.asarray(self["coulomb"] / self["presliding"])

    @property
    def spread(self) -> Array:
        """Prior standard deviations of the coordinates, shape (len(QUANTITIES), n)."""
        return _SPREAD * np.where(_PER_TORQUE, self.stall, 1.0)

    @property
    def coordinates(self) -> Array:
        """Values to fit, logarithms of positive ones, shape (len(QUANTITIES), n)."""
        out = self.values.copy()
        return np.asarray(np.log(out, out=out, where=LOGARITHMIC))

    def moved(self, coordinates: Array) -> Drive:
        """A copy with other coordinates."""
        positive = np.exp(np.clip(coordinates, -_FAR, _FAR))
        values = np.where(LOGARITHMIC, positive, coordinates)
        return replace(self, values=np.maximum(values, _LEAST))

    @classmethod
    def declared(cls, robot: Robot) -> Drive:
        """The servos of a robot file, with usual values where it states none."""
        stall = rated_torque(robot)
        little = _LITTLE * stall
        drive = cls(np.zeros((len(NAMES), robot.size)), stall).at(
            stiffness=np.where(np.isfinite(robot.kp), robot.kp, stall / 0.1),
            damping=np.maximum(np.nan_to_num(robot.kd) + robot.damping, little),
            coulomb=robot.frictionloss,
            stribeck_speed=0.05,
            presliding=_PRESLIDING,
            armature=np.maximum(robot.chain.armature, little),
            stall=np.where(np.isfinite(robot.tau_max), stall, _UNLIMITED * stall),
            delay=robot.latency,
            quadratic=np.nan_to_num(robot.quadratic),
            lower=np.where(np.isfinite(robot.q_min), robot.q_min, -_FREE),
            upper=np.where(np.isfinite(robot.q_max), robot.q_max, _FREE),
            mass=1.0,
            ground=-_reach(robot),
            sign=1.0,
        )
        for names, rows in ((_FALL, robot.falling), (_BRISTLE, robot.bristle)):
            for j, *numbers in rows:
                for name, x in zip(names, numbers, strict=True):
                    drive[name][int(j)] = x
        return drive.at(coulomb=np.maximum(drive["coulomb"], little))


def known_masses(robot: Robot, known: Mapping[str, float]) -> Array:
    """Masses of the links over those of the file, shape (n,).

    Known links, each by the name of the joint that moves it, [kg], have their own
    ratio, all others the geometric mean of these.

    Raises:
        RobotError: No joint has that name, or its link has no mass in the file.
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
    """Upper bound of the distance of each centre of mass from the base, (n,), [m]."""
    chain = robot.chain
    ends = np.nan_to_num([robot.q_min, robot.q_max], posinf=0.0, neginf=0.0)
    slides = np.where(chain.revolute, 0.0, np.abs(ends).max(axis=0))
    joints = np.cumsum(np.linalg.norm(chain.translation, axis=1) + slides)
    return np.asarray(joints + np.linalg.norm(centres(robot), axis=1))


def centres(robot: Robot) -> Array:
    """Centre of mass of every link in its frame, shape (n, 3), [m]."""
    inertial = robot.chain.inertial
    return np.asarray(inertial[:, 1:4] / np.maximum(inertial[:, :1], 1e-12))
