"""Effects that no file of the library describes. Each is invented, yet physical.

A diagnosis should say that something is there, where, and that it does not know what.
Their columns are empty on purpose: they exist in plants only.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from blind.past import past
from hybrid.arrays import Array
from hybrid.effects import Body, Effect, JointState, Port, Quantity, Scope
from hybrid.effects.joint_effect import JointEffect
from hybrid.signals import Motion


class Stranger(Effect):
    """What a plant has and the library does not."""

    port = Port.DRIVE
    source = "invented for the benchmark"
    sentence = remedy = ""
    gains = (Quantity("level", "N·m", 0.03, 0.0, 0.3, per=(1, 0)),)
    over: ClassVar[str] = "joint"  # where it is drawn: a joint, a pair, or the arm

    def columns(self, motion: Motion, body: Body) -> Array:
        """None: no fit knows it; shape (N, r, p)."""
        return np.zeros((len(motion.t), len(self.joints), len(self.gains)))


class PositionFriction(JointEffect):
    """A worn gear: dry friction that is larger in some places."""

    id = "position_friction"
    port = Port.DRIVE
    dry = True
    gains = (Quantity("level", "N·m", 0.04, 0.0, 0.3, per=(1, 0)),)
    shapes = (Quantity("waves", "1/turn", 5.0, 1.0, 12.0),)
    equation = "τ = F · sin²(m q) · sgn v"
    source = Stranger.source
    sentence = remedy = ""
    over: ClassVar[str] = "joint"

    @staticmethod
    def law(state: JointState, **shapes: Any) -> Sequence[Array]:
        """Torque per N·m of level."""
        return (np.sin(shapes["waves"] * state.q) ** 2 * state.sign,)


class CablePull(Stranger):
    """A cable along two joints that pulls by where both of them stand."""

    id = "cable_pull"
    scope: ClassVar[Scope] = "coupling"
    over = "pair"
    shapes = (Quantity("turns", "", 2.0, 1.0, 4.0),)
    equation = "τ = −∂U/∂q, U = F · sin(m q₁ + q₂) · cos(q₁ − m q₂)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """Gradient of the cable's energy, so that none is made."""
        m, (q, r) = self.values["turns"], (state.q[:, 0], state.q[:, 1])
        a, b = m * q + r, q - m * r
        first = m * np.cos(a) * np.cos(b) - np.sin(a) * np.sin(b)
        second = np.cos(a) * np.cos(b) + m * np.sin(a) * np.sin(b)
        return self.values["level"] * np.stack([first, second], axis=1)


class ShakenMass(Stranger):
    """Something loose that the other joint's acceleration sets swinging."""

    id = "shaken_mass"
    scope: ClassVar[Scope] = "coupling"
    over = "pair"
    shapes = (
        Quantity("frequency", "Hz", 3.0, 1.5, 8.0),
        Quantity("damping", "", 0.08, 0.02, 0.3),
    )
    equation = "τ₂ = F · x, d²x/dt² + 2ζω dx/dt + ω² x = ω² a₁/(1 rad/s²)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """One semi-implicit step of the swing."""
        swing = past(self, state, "place", "speed")
        omega = 2 * np.pi * self.values["frequency"]
        place, speed = swing["place"], swing["speed"]
        drive = state.a[:, :1] - place
        rush = omega**2 * drive - 2 * self.values["damping"] * omega * speed
        swing["speed"] = speed + step * rush
        swing["place"] = place + step * swing["speed"]
        torque = np.zeros_like(before)
        torque[:, 1] = self.values["level"] * swing["place"][:, 1]
        return torque


class ClockBursts(Stranger):
    """Torque that comes in bursts of a fixed period: a bus that stutters."""

    id = "clock_bursts"
    shapes = (
        Quantity("period", "s", 0.7, 0.3, 2.0),
        Quantity("decay", "s", 0.06, 0.02, 0.2),
    )
    equation = "τ = F · exp(−(t mod P)/d)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """The same for all, by the clock."""
        since = np.mod(state.t, self.values["period"])
        return self.values["level"] * np.exp(-since / self.values["decay"])


class LoadHysteresis(Stranger):
    """A gear that gives back less load than it took: memory of torque."""

    id = "load_hysteresis"
    shapes = (Quantity("reach", "N·m", 0.06, 0.02, 0.2, per=(1, 0)),)
    equation = "τ = F · s/r, s = clip(s + Δτ_load, ±r)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """Stop operator of the transmitted load, which is smoothed over 10 ms."""
        seen = past(self, state, "load", "stop")
        fresh = seen["load"] + min(1.0, step / 0.01) * (state.load - seen["load"])
        reach = self.values["reach"]
        seen["stop"] = np.clip(seen["stop"] + fresh - seen["load"], -reach, reach)
        seen["load"] = fresh
        return self.values["level"] * seen["stop"] / reach


class FastFieldWeakening(Stranger):
    """A torque constant that falls with speed."""

    id = "field_weakening"
    gains = (Quantity("level", "s²/rad²", 0.1, 0.0, 0.6, per=(0, -2)),)
    equation = "τ = F · v² · τ_load"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """More is asked for the same load when the joint is fast."""
        return self.values["level"] * state.v**2 * state.load


class SupplySag(Stranger):
    """A common supply: each drive gives less while all together draw power."""

    id = "supply_sag"
    scope: ClassVar[Scope] = "arm"
    over = "arm"
    gains = (Quantity("level", "s/(N·m·rad)", 0.15, 0.0, 0.6, per=(-1, -1)),)
    equation = "τ_k = F · τ_load,k · Σ |τ_load,i v_i|"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """The sag follows the power within 20 ms."""
        seen = past(self, state, "power")
        power = np.abs(state.load * state.v).sum(axis=1, keepdims=True)
        seen["power"] += min(1.0, step / 0.02) * (power - seen["power"])
        return self.values["level"] * seen["power"] * state.load


class PumpVibration(Stranger):
    """A pump next to the arm shakes it at its own pace."""

    id = "pump_vibration"
    shapes = (Quantity("frequency", "Hz", 6.0, 2.0, 12.0),)
    equation = "τ = F · sin(2πf t)"

    def resist(self, state: JointState, before: Array, step: float) -> Array:
        """A wave in time."""
        return self.values["level"] * np.sin(
            2 * np.pi * self.values["frequency"] * state.t
        )


class SensorDrift(Stranger):
    """A torque sensor whose zero wanders."""

    id = "sensor_drift"
    port = Port.MEASUREMENT
    shapes = (Quantity("frequency", "Hz", 0.13, 0.05, 0.4),)
    equation = "τ_reported = τ + F · (sin ωt + sin(1.618 ωt + 1))/√2"

    def measure(self, t: Array, signals: dict[str, Array]) -> dict[str, Array]:
        """Two slow waves that do not repeat within a recording."""
        omega, tau = 2 * np.pi * self.values["frequency"], signals["tau"].copy()
        wave = np.sin(omega * t) + np.sin(1.618 * omega * t + 1.0)
        tau[:, self.joints[0]] += self.values["level"] * wave / np.sqrt(2)
        return signals | {"tau": tau}


STRANGERS: dict[str, type[Any]] = {
    cls.id: cls
    for cls in (
        PositionFriction, CablePull, ShakenMass, ClockBursts, LoadHysteresis,
        FastFieldWeakening, SupplySag, PumpVibration, SensorDrift,
    )
}  # fmt: skip
