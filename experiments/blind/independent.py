"""Library effects a second time, from other equations or another author's code.

Simulating a law with the code that fits it proves little. Friction with a bristle
state, cogging, a spring that stiffens and the inertia of a box are MuJoCo's own; all
others are written anew, in another form than the library's, and some hold a little of
what no law of it has. (The saturation and heating of MuJoCo's motor are of its voltage
and winding: they act on a voltage, and the plant's drives are commanded a torque.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from blind.past import past
from blind.strangers import Stranger
from hybrid.arrays import Array
from hybrid.effects import JointState, Port, Quantity, Scope

if TYPE_CHECKING:
    import mujoco

# A torque constant so small that the motor without a voltage brakes nothing.
_NO_WINDING = [1e-9, 1e-9]
_PASSIVE = 16  # mjINPUT_NONE
_BEND = 3e-4  # rad, over which bristles bend


class BristleMotor(Stranger):
    """LuGre friction of MuJoCo's DC motor, without Stribeck's bump."""

    id = "bristle_motor"
    means: ClassVar[str] = "presliding"
    gains = (Quantity("level", "N·m", 0.04, 0.0, 0.3, per=(1, 0)),)
    shapes = (Quantity("distance", "rad", 0.005, 0.001, 0.05),)
    equation = "τ = σ₀ z + σ₁ dz/dt, dz/dt = v − σ₀ |v| z/F"

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Put a motor that is only friction onto the joint."""
        level, distance = self.values["level"], self.values["distance"]
        if level > 0:
            stiffness = level / distance
            lugre = [stiffness, 0.01 * stiffness, level, level, 0.1]
            _motor(spec, names[self.joints[0]], self.id, lugre=lugre)


class CoggingMotor(Stranger):
    """Cogging of MuJoCo's DC motor."""

    id = "cogging_motor"
    means: ClassVar[str] = "torque_ripple"
    gains = (Quantity("level", "N·m", 0.02, 0.0, 0.15, per=(1, 0)),)
    shapes = (
        Quantity("poles", "1/turn", 24.0, 4.0, 200.0),
        Quantity("phase", "rad", 1.0, 0.0, 6.2832),
    )
    equation = "τ = −F · sin(N q + φ)"

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Put a motor that only cogs onto the joint."""
        v = self.values
        cogging = [v["level"], float(round(v["poles"])), v["phase"]]
        _motor(spec, names[self.joints[0]], self.id, cogging=cogging)


def _motor(spec: mujoco.MjSpec, joint: str, name: str, **parts: Any) -> None:
    motor = spec.add_actuator(name=f"{joint}/{name}")
    motor.trntype = type(motor.trntype).mjTRN_JOINT
    motor.target = joint
    motor.set_to_dcmotor(
        motorconst=_NO_WINDING, resistance=1.0, ctrlspec=_PASSIVE, **parts
    )


class SelfHeatingGear(Stranger):
    """Viscous friction that its own loss warms away: a heat balance, not a clock."""

    id = "self_heating_gear"
    means: ClassVar[str] = "thermal_friction"
    gains = (Quantity("cold", "N·m·s/rad", 0.08, 0.0, 1.0, per=(1, -1)),)
    shapes = (Quantity("loss", "rad²/s", 0.3, 0.05, 3.0, per=(0, 2)),)
    equation = "τ = F · e^(−h) · v, dh/dt = e^(−h) v²/ℓ − h/60 s"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """One step of the warmth h."""
        gear = past(self, state, "warmth")
        thin = np.exp(-gear["warmth"])
        heat = thin * state.v**2 / self.values["loss"] - gear["warmth"] / 60.0
        gear["warmth"] = gear["warmth"] + step * heat
        return self.values["cold"] * thin * state.v


class SoftSaturation(Stranger):
    """Iron that saturates little by little."""

    id = "soft_saturation"
    means: ClassVar[str] = "saturation"
    gains = (Quantity("loss", "", 0.6, 0.0, 1.0),)
    shapes = (Quantity("limit", "N·m", 0.3, 0.02, 2.0, per=(1, 0)),)
    equation = "τ_delivered = τ − p · (τ − L (τ/L)/(1 + (τ/L)⁶)^(1/6))"

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        limit = self.values["limit"]
        kept = torque / (1.0 + (torque / limit) ** 6) ** (1.0 / 6.0)
        return np.asarray(torque - self.values["loss"] * (torque - kept))


class Dahl(Stranger):
    """Dry friction that builds up over a third of a milliradian, as bristles bend."""

    means: ClassVar[str] = "coulomb"
    id = "dahl_friction"
    gains = (Quantity("level", "N·m", 0.03, 0.0, 0.3, per=(1, 0)),)
    equation = "dτ/dt = (F sgn v − τ) |v|/(0.0003 rad)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """The exact solution of a step at constant speed."""
        seen = past(self, state, "bent", "load")
        # Teeth carry what they carried over the last 5 ms.
        seen["load"] += min(1.0, step / 0.005) * (state.load - seen["load"])
        end = np.sign(state.v) * self.full(state.v, seen["load"])
        kept = np.exp(-np.abs(state.v) * step / _BEND)
        seen["bent"] = end + (seen["bent"] - end) * kept
        return seen["bent"]

    def full(self, v: Array, load: Array) -> Array:
        """Friction of bristles that are fully bent."""
        return np.full_like(v, self.values["level"])


class LorentzFriction(Dahl):
    """Friction that falls with the square of speed, and not exponentially."""

    id = "lorentz_friction"
    means: ClassVar[str] = "stribeck"
    shapes = (Quantity("velocity", "rad/s", 0.05, 0.01, 0.3),)
    equation = "Dahl's, of F/(1 + (v/v_s)²)"

    def full(self, v: Array, load: Array) -> Array:
        """See :meth:`Dahl.full`."""
        return self.values["level"] / (1.0 + (v / self.values["velocity"]) ** 2)


class ToothFriction(Dahl):
    """Friction of teeth by the load that they carry, with a lag."""

    id = "tooth_friction"
    means: ClassVar[str] = "load_friction"
    gains = (Quantity("level", "", 0.1, 0.0, 0.5),)
    equation = "Dahl's, of μ |τ̄_load|"

    def full(self, v: Array, load: Array) -> Array:
        """See :meth:`Dahl.full`."""
        return self.values["level"] * np.abs(load)


class StiffeningHose(Stranger):
    """A hose that pulls harder the farther it is bent."""

    id = "stiffening_hose"
    means: ClassVar[str] = "stiffening_spring"
    gains = (Quantity("level", "N·m/rad", 0.05, 0.0, 0.5, per=(1, 0)),)
    shapes = (Quantity("rest", "rad", 0.5, 0.05, 2.0),)
    equation = "τ = k · 4 sinh((q − q₀)/4)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """By the position alone."""
        bent = (state.q - self.values["rest"]) / 4.0
        return self.values["level"] * 4.0 * np.sinh(bent)


class WobblyDisc(Stranger):
    """An encoder disc off its axis, by the exact angle under which its head sees it."""

    id = "wobbly_disc"
    port = Port.MEASUREMENT
    means: ClassVar[str] = "encoder_eccentricity"
    gains = (Quantity("level", "", 0.006, 0.0, 0.05),)
    shapes = (Quantity("phase", "rad", 1.0, 0.0, 6.2832),)
    equation = "q_measured = q + atan(e sin(q − φ)/(1 − e cos(q − φ)))"

    def sense(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Position and speed that the encoder shows."""
        e, angle = self.values["level"], q - self.values["phase"]
        sine, cosine = np.sin(angle), np.cos(angle)
        error = np.arctan2(e * sine, 1.0 - e * cosine)
        slope = (e * cosine - e**2) / (1.0 - 2.0 * e * cosine + e**2)
        return q + error, v * (1.0 + slope)


class BoxcarLog(Stranger):
    """A logger that writes the mean torque of the last cycles."""

    id = "boxcar_log"
    port = Port.MEASUREMENT
    means: ClassVar[str] = "delay"
    gains = (Quantity("level", "s", 0.008, 0.0, 0.03),)
    equation = "τ_reported(t) = mean of τ from t − 2T to t"

    def measure(self, t: Array, signals: dict[str, Array]) -> dict[str, Array]:
        """The mean, from the integral of torque."""
        tau, j = signals["tau"].copy(), self.joints[0]
        window = 2.0 * self.values["level"]
        pairs = (tau[1:, j] + tau[:-1, j]) / 2.0 * np.diff(t)
        whole = np.concatenate([[0.0], np.cumsum(pairs)])
        earlier = np.interp(t - window, t, whole)
        earlier += np.minimum(t - window - t[0], 0.0) * tau[0, j]
        tau[:, j] = (whole - earlier) / window
        return signals | {"tau": tau}


class BrushDrop(Stranger):
    """A drive that loses a part of small torques, little by little."""

    id = "brush_drop"
    means: ClassVar[str] = "deadzone"
    gains = (Quantity("level", "N·m", 0.02, 0.0, 0.3, per=(1, 0)),)
    equation = "τ_delivered = τ − w τ/√(τ² + w²/4)"

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        lost = self.values["level"]
        return np.asarray(torque - lost * torque / np.hypot(torque, lost / 2.0))


class MagnetLoss(Stranger):
    """Magnets that lost strength, in iron that saturates a little."""

    id = "magnet_loss"
    means: ClassVar[str] = "torque_gain"
    gains = (Quantity("level", "", 0.1, 0.0, 0.4),)
    shapes = (Quantity("limit", "N·m", 1.0, 0.5, 2.0, per=(1, 0)),)
    equation = "τ_delivered = (1 − p) τ/√(1 + (τ/5L)²)"

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        full = np.hypot(1.0, torque / (5.0 * self.values["limit"]))
        return np.asarray((1.0 - self.values["level"]) * torque / full)


class Crate(Stranger):
    """A box of MuJoCo on the last link, which works its inertia out by itself."""

    id = "crate"
    means: ClassVar[str] = "payload"
    scope: ClassVar[Scope] = "arm"
    over = "arm"
    gains = (Quantity("level", "kg", 0.5, 0.0, 5.0),)
    shapes = (
        Quantity("edge", "m", 0.06, 0.03, 0.15),
        Quantity("away", "m", 0.06, 0.02, 0.2),
    )
    equation = "a box of mass m"

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Put a box onto the last link."""
        mass, edge, away = (self.values[x] for x in ("level", "edge", "away"))
        if mass > 0:
            geom = spec.body(names[self.joints[-1]]).add_body().add_geom()
            geom.type = type(geom.type).mjGEOM_BOX
            geom.size, geom.pos = [edge, edge / 2, edge / 3], [away / 2, 0.0, away]
            geom.mass, geom.contype, geom.conaffinity = mass, 0, 0


class HardeningGear(Stranger):
    """A gear whose spring is a third stiffer at its knee."""

    id = "hardening_gear"
    port = Port.TRANSMISSION
    means: ClassVar[str] = "elasticity"
    behind = "twist"
    gains = (Quantity("level", "rad/(N·m)", 0.01, 0.0, 0.1, per=(-1, 0)),)
    shapes = (
        Quantity("knee", "N·m", 0.5, 0.2, 2.0, per=(1, 0)),
        Quantity("damping", "N·m·s/rad", 0.02, 0.005, 0.2, per=(1, -1)),
    )
    equation = "τ = K d (1 + (K d/τ_k)²/3) + D dd/dt"

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Put a spring between motor and link."""
        soft, knee = self.values["level"], self.values["knee"]
        if soft > 0:
            gear = self.added_joint(spec, names[self.joints[0]])
            cubic = 1.0 / (3.0 * soft * (soft * knee) ** 2)
            gear.stiffness = np.array([1.0 / soft, 0.0, cubic])
            gear.damping = np.array([self.values["damping"], 0.0, 0.0])


INDEPENDENT: dict[str, type[Any]] = {
    cls.id: cls
    for cls in (
        BristleMotor, CoggingMotor, SelfHeatingGear, SoftSaturation, Dahl,
        LorentzFriction, ToothFriction, StiffeningHose, WobblyDisc, BoxcarLog,
        BrushDrop, MagnetLoss, Crate, HardeningGear,
    )
}  # fmt: skip
