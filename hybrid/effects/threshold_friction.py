"""Friction with separate laws below and above a speed threshold."""

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid.effects import (
    FASTEST,
    JointEffect,
    JointState,
    Port,
    Quantity,
    Scalar,
    continued,
)


class ThresholdFriction(JointEffect):
    """Nonlinear friction with a velocity threshold λ, continuous everywhere.

    Above λ there is a dry level for each direction and a cubic polynomial of speed.
    Below λ the level may fall towards λ, linearly and quadratically (break-away), or
    rise to it (a knee); the law is continuous at λ. The sum of rising and falling parts
    is a level, so a fit needs only one of the two. Within ±``width`` the law is a
    straight line through zero. Beyond ``fastest``, the highest speed in the data, it is
    its tangent. All coefficients are non-negative, so friction always takes energy.
    """

    id = "threshold_friction"
    port = Port.DRIVE
    composite = True
    fields = {
        "coulomb_positive": "frictionloss",
        "coulomb_negative": "frictionloss",
        "viscous": "damping",
        "quadratic": "quadratic",
        "cubic": "cubic",
    }
    dry = True
    gains = (
        Quantity("coulomb_positive", "N·m", 0.04, 0.0, 0.5, per=(1, 0)),
        Quantity("coulomb_negative", "N·m", 0.04, 0.0, 0.5, per=(1, 0)),
        Quantity("falling", "N·m", 0.01, 0.0, 0.5, per=(1, 0)),
        Quantity("falling_steep", "N·m", 0.01, 0.0, 0.5, per=(1, 0)),
        Quantity("rising", "N·m", 0.0, 0.0, 0.5, per=(1, 0)),
        Quantity("viscous", "N·m·s/rad", 0.05, 0.0, 1.0, per=(1, -1)),
        Quantity("quadratic", "N·m·s²/rad²", 0.0, 0.0, 1.0, per=(1, -2)),
        Quantity("cubic", "N·m·s³/rad³", 0.0, 0.0, 1.0, per=(1, -3)),
    )
    shapes = (
        Quantity("threshold", "rad/s", 0.2, 0.0001, 100.0),
        Quantity("width", "rad/s", 0.002, 0.0, 10.0),
        FASTEST,
    )
    equation = (
        "τ = k_c± σ(v) + k_f σ(v)(1 − |v|/λ)₊ + k_s σ(v)(1 − |v|/λ)₊² "
        "+ k_r σ(v) min(|v|/λ, 1) + k_v1 v + k_v2 v|v| + k_v3 v³"
    )
    source = "Armstrong-Hélouvry et al. 1994, doi 10.1016/0005-1098(94)90209-7"
    sentence = "Friction of {joints} is a curve with a knee, not a level and a slope."
    remedy = "Give the joint a friction table over speed."

    @property
    def exact_fields(self) -> Mapping[str, str]:
        """All fields; without the levels if these rise from zero at rest."""
        dry = self.values["width"] == 0.0
        return {k: x for k, x in self.fields.items() if dry or x != "frictionloss"}

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per unit of each coefficient."""
        speed, width = abs(state.v), shapes["width"]
        # Without a width the full level acts at rest too, where a plant has a sign.
        ramp = np.where(speed < width, speed / np.maximum(width, 1e-12), 1.0)
        sigma = state.sign * ramp
        below = np.clip(1.0 - speed / shapes["threshold"], 0.0, None)
        return (
            np.where(state.sign > 0, sigma, 0.0),
            np.where(state.sign < 0, sigma, 0.0),
            sigma * below,
            sigma * below**2,
            sigma * (1.0 - below),
            state.sign * speed,
            state.sign * continued(speed, shapes["fastest"], 2),
            state.sign * continued(speed, shapes["fastest"], 3),
        )
