"""Library effects a second time, from other equations or another author's code.

Simulating a law with the code that fits it proves little. Friction with a bristle state
and cogging are those of MuJoCo's DC motor, here without winding; a gear that warms up
by its own loss and soft saturation are written anew. (The motor's own saturation and
heating are of its voltage and winding: they act on a voltage, and the plant's drives
are commanded a torque.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from blind.past import past
from blind.strangers import Stranger
from hybrid.arrays import Array
from hybrid.effects import JointState, Quantity

if TYPE_CHECKING:
    import mujoco

# A torque constant so small that the motor without a voltage brakes nothing.
_NO_WINDING = [1e-9, 1e-9]
_PASSIVE = 16  # mjINPUT_NONE


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


INDEPENDENT: dict[str, type[Any]] = {
    cls.id: cls for cls in (BristleMotor, CoggingMotor, SelfHeatingGear, SoftSaturation)
}
