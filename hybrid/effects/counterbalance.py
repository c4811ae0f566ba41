"""A cylinder or spring that carries part of an arm's weight."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.effect import JointState, Port, Quantity
from hybrid.effects.joint_effect import JointEffect


class Counterbalance(JointEffect):
    """Gas, hydraulic or coil spring between the base and a crank on the link.

    With the crank's radius r, the distance a of the two pivots from each other's axis
    and λ(q) = l/a the relative length of the spring, l² = a² + r² − 2 a r cos(q − φ),
    a force F₀ + k (l − l₀) has the lever a r sin(q − φ)/l. Its torque has two parts:
    k a r · sin(q − φ), which a link's weight may look like, and
    (F₀ − k l₀) r · sin(q − φ)/λ, which tells a spring from a weight.
    """

    id = "counterbalance"
    port = Port.ENVIRONMENT
    becomes = "crank_ratio", "lower", "torque_ripple"
    gains = (
        Quantity("spring", "N·m", 0.05, 0.0, 5.0, per=(1, 0)),
        Quantity("preload", "N·m", 0.1, -5.0, 5.0, per=(1, 0)),
    )
    shapes = (
        # More than a turn, of which no end is in the way of a fit.
        Quantity("dead_centre", "rad", 0.0, -4.0, 4.0),
        Quantity("crank_ratio", "", 0.3, 0.01, 0.95),
    )
    equation = "τ = (K + P/λ) · sin(q − φ), λ = √(1 + ρ² − 2 ρ cos(q − φ))"
    source = "Arakelian 2016, doi 10.1080/01691864.2015.1090334"
    sentence = "A counterbalance carries part of the weight on {joints}."
    remedy = "Add the cylinder as a tendon between its two pivots."

    def as_reported(self) -> Counterbalance:
        """The same with its dead centre within half a turn of zero."""
        angle = self.values["dead_centre"]
        if abs(angle) <= np.pi:
            return self
        return self.at({"dead_centre": float(np.angle(np.exp(1j * angle)))})

    @staticmethod
    def law(state: JointState, **shapes: Any) -> Sequence[Array]:
        """Torque per N·m of the spring's and of the preload's part."""
        angle, ratio = state.q - shapes["dead_centre"], shapes["crank_ratio"]
        sine = np.sin(angle)
        length = np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(angle))
        return sine, sine / length
