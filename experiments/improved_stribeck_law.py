"""Coulomb, Stribeck and viscous friction in one law, linear about rest.

``--effects-from`` adds it to the library of effects.
"""

from collections.abc import Sequence

import numpy as np

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class ImprovedStribeck(JointEffect):
    """Friction from break-away to sliding; a line through rest below ``width``.

    The published law is even where it should be odd, and jumps at ±``width`` if it has
    an offset. This law is odd and continuous: within ±``width`` it is a straight line
    through zero. An offset is an effect of its own,
    :class:`~hybrid.effects.torque_offset.TorqueOffset`.
    """

    id = "improved_stribeck"
    port = Port.DRIVE
    composite = True
    fields = {"viscous": "damping"}
    dry = True
    gains = (
        Quantity("coulomb", "N·m", 0.04, 0.0, 0.5, per=(1, 0)),
        Quantity("static", "N·m", 0.06, 0.0, 0.8, per=(1, 0)),
        Quantity("viscous", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, -1)),
    )
    shapes = (
        Quantity("velocity", "rad/s", 0.05, 0.001, 1.0),
        Quantity("width", "rad/s", 0.002, 0.0, 0.1),
    )
    equation = (
        "τ = [f_C + (f_S − f_C)·exp(−(u/v_s)²)]·clip(v/v₀, −1, 1) + f_V·v, "
        "u = max(|v|, v₀)"
    )
    source = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    sentence = "Friction of {joints} falls from break-away to sliding, then rises."
    remedy = (
        "Give the joint a Stribeck curve: break-away, sliding and viscous friction."
    )

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of sliding, break-away and viscous friction."""
        speed, width = abs(state.v), shapes["width"]
        stuck = np.exp(-((np.maximum(speed, width) / shapes["velocity"]) ** 2))
        # Without a width the full level acts at rest too, where a plant has a sign.
        ramp = np.where(speed < width, speed / np.maximum(width, 1e-12), 1.0)
        sigma = state.sign * ramp
        return (sigma * (1.0 - stuck), sigma * stuck, state.sign * speed)
