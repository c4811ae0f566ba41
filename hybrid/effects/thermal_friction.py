"""Additional viscous friction of a cold gear."""

from collections.abc import Sequence

import numpy as np

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar

_ROOM = 20.0  # °C


class ThermalFriction(JointEffect):
    """Viscous friction of cold oil in addition to that of warm oil: F·w·v.

    The weight w falls from 1 towards 0. It is a function of the drive's temperature, or
    of the time of the recording if no temperature is measured.
    """

    id = "thermal_friction"
    port = Port.DRIVE
    fields = {"cold": "friction"}
    warms = True
    becomes = "time_constant", "upper", "viscous"
    gains = (Quantity("cold", "N·m·s/rad", 0.04, 0.0, 1.0, per=(1, -1)),)
    shapes = (
        Quantity("time_constant", "s", 300.0, 5.0, 10000.0),
        Quantity("temperature_scale", "K", 20.0, 5.0, 100.0),
    )
    equation = "τ = F · w · v, w = exp(−t/t_c) or exp(−(T − 20 °C)/T_c)"
    source = "Bittencourt and Gunnarsson 2012, doi 10.1115/1.4006589"
    sentence = "Friction of {joints} falls as it warms up."
    remedy = "Warm the arm up first, or let damping follow the drive's temperature."

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per N·m·s/rad of cold friction."""
        if state.temperature is None:
            return (np.exp(-state.t / shapes["time_constant"]) * state.v,)
        warmth = (state.temperature - _ROOM) / shapes["temperature_scale"]
        return (np.exp(-warmth) * state.v,)
