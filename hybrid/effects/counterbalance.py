"""A cylinder or spring that balances a part of the arm's weight."""

from collections.abc import Sequence
from typing import Self

import numpy as np

from hybrid.effects import JointEffect, JointState, Port, Quantity, Scalar


class Counterbalance(JointEffect):
    """Gas, hydraulic or coil spring between the base and a crank on the link.

    The crank has the radius r, and the fixed pivot the distance a from the joint axis.
    The length of the spring is l, with l² = a² + r² − 2 a r cos(q − φ) and λ(q) = l/a.
    Its force F₀ + k (l − l₀) acts with the lever a r sin(q − φ)/l. The torque has two
    parts: k a r · sin(q − φ), which is like the weight of a link, and
    (F₀ − k l₀) r · sin(q − φ)/λ, which is not.
    """

    id = "counterbalance"
    port = Port.ENVIRONMENT
    becomes = "crank_ratio", "lower", "torque_ripple"
    gains = (
        Quantity("spring", "N·m", 0.05, 0.0, 5.0, per=(1, 0)),
        Quantity("preload", "N·m", 0.1, -5.0, 5.0, per=(1, 0)),
    )
    shapes = (
        # More than a turn, so that a fit does not stop at a bound.
        Quantity("dead_centre", "rad", 0.0, -4.0, 4.0),
        Quantity("crank_ratio", "", 0.3, 0.01, 0.95),
    )
    equation = "τ = (K + P/λ) · sin(q − φ), λ = √(1 + ρ² − 2 ρ cos(q − φ))"
    source = "Arakelian 2016, doi 10.1080/01691864.2015.1090334"
    sentence = "A counterbalance carries part of the weight on {joints}."
    remedy = "Add the cylinder as a tendon between its two pivots."

    def as_reported(self) -> Self:
        """The same with its dead centre between −π and π."""
        angle = self.values["dead_centre"]
        if abs(angle) <= np.pi:
            return self
        return self.at({"dead_centre": float(np.angle(np.exp(1j * angle)))})

    @staticmethod
    def law(state: JointState, **shapes: Scalar) -> Sequence[Scalar]:
        """Torque per N·m of spring and of preload."""
        angle, ratio = state.q - shapes["dead_centre"], shapes["crank_ratio"]
        sine = np.sin(angle)
        length = np.sqrt(1.0 + ratio**2 - 2.0 * ratio * np.cos(angle))
        return sine, sine / length
