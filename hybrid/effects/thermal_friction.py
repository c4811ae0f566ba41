"""Additional viscous friction of a cold gear."""

from collections.abc import Sequence
from typing import Self

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import (
    Body,
    Effect,
    JointState,
    Memory,
    Port,
    Quantity,
    Scalar,
    Scale,
)
from hybrid.signals import Motion

_ROOM = 20.0  # °C
_BY_TEMPERATURE = Quantity("temperature_scale", "K", 20.0, 5.0, 100.0)
_BY_HEAT = (
    Quantity("time_constant", "s", 300.0, 5.0, 10000.0),
    Quantity("warm_up", "rad²/s", 30.0, 0.1, 1000.0, per=(0, 2)),
)


class ThermalFriction(Effect):
    """Viscous friction of cold oil in addition to that of warm oil: F·w·v.

    The weight w = exp(−h) falls from 1 towards 0 with the rise h of the temperature,
    relative to the one that thins oil by a factor e. If no temperature is measured, the
    drive heats the oil evenly while it is on, and its friction by what it loses:
    dh/dt = 1/t_c + w·v²/E. As this is linear in 1/w, it has a closed form. With E = ∞,
    w follows the clock. Each recording starts cold; cooling by the air is left out.
    """

    id = "thermal_friction"
    port = Port.DRIVE
    fields = {"cold": "friction"}
    memory = ("heat",)
    warms = True
    becomes = "time_constant", "upper", "viscous"
    choices = 4.0  # as of two shapes: motions show two of the three at most
    gains = (Quantity("cold", "N·m·s/rad", 0.04, 0.0, 1.0, per=(1, -1)),)
    shapes = (*_BY_HEAT, _BY_TEMPERATURE)
    equation = "τ = F · w · v, w = exp(−(T − 20 °C)/T_c), or dw/dt = −w/t_c − w² v²/E"
    source = "Bittencourt and Gunnarsson 2012, doi 10.1115/1.4006589"
    sentence = "Friction of {joints} falls as it warms up."
    remedy = "Warm the arm up first, or let damping follow the drive's temperature."

    @classmethod
    def shapes_along(cls, motions: Sequence[Motion]) -> tuple[Quantity, ...]:
        """See :meth:`Effect.shapes_along`: the temperature, or what would raise it."""
        measured = all(m.temperature is not None for m in motions)
        return (_BY_TEMPERATURE,) if measured else _BY_HEAT

    def at_limit(self, scale: Scale) -> tuple[Self, str] | None:
        """See :meth:`Effect.at_limit`: neither the drive nor the loss heats."""
        limit = super().at_limit(scale)
        most = {x.name: x.scaled(scale).upper for x in _BY_HEAT}
        return limit and (limit[0].at(most), limit[1])

    def remembered(self, motion: Motion) -> Sequence[Array]:
        """See :meth:`Effect.remembered`."""
        v, t = motion.v[:-1, self.joints[0]], motion.t
        heat = np.cumsum(self._heat(t[:-1], v, np.diff(t)))
        return (np.append(0.0, heat),)

    def columns(self, motion: Motion, body: Body) -> Array:
        """See :meth:`Effect.columns`; shape (N, 1, 1)."""
        (j,), warm = self.joints, motion.temperature
        (heat,) = self.remembered(motion)
        weight = self._weight(motion.t, heat, None if warm is None else warm[:, j])
        return np.asarray((weight * motion.v[:, j])[:, None, None])

    def begin(self, joints: Sequence[JointState]) -> Memory:
        """No heat by a joint that has not moved yet."""
        return (0.0,)

    def at_instant(
        self, joints: Sequence[JointState], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """See :meth:`Effect.at_instant`; the joint heats for the step to come."""
        (heat,), (state,) = memory, joints
        weight = self._weight(state.t, heat, state.temperature)
        heat = heat + self._heat(state.t, state.v, step)
        return [self.values["cold"] * weight * state.v], (heat,)

    def _heat(self, t: Scalar, v: Scalar, step: Scalar) -> Scalar:
        """Growth of 1/w in a step [s], but for that with the clock."""
        alone = np.exp(-t / self.values["time_constant"])
        return alone * v**2 * step / self.values["warm_up"]

    def _weight(self, t: Scalar, heat: Scalar, temperature: Scalar | None) -> Scalar:
        if temperature is not None:
            return np.exp(-(temperature - _ROOM) / self.values["temperature_scale"])
        return np.exp(-t / self.values["time_constant"]) / (1.0 + heat)
