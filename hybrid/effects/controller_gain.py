"""Servo gains that differ from the stated ones."""

from collections.abc import Mapping

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity
from hybrid.signals import Motion


class ControllerGain(Effect):
    """Stiffness and damping of the servo differ by a factor.

    This changes the torque for a command, but not the torque for a motion.
    """

    id = "controller_gain"
    port = Port.COMMAND
    # Relative to the whole gains; noise of the speed limits the damping.
    inexact = {"damping": 0.03, "stiffness": 0.001}
    at_scale = ("torque_gain",)
    not_in_loop = "it lies between command and torque"
    gains = (
        Quantity("stiffness", "", -0.2, -0.9, 5.0),
        Quantity("damping", "", -0.2, -0.9, 5.0),
    )
    equation = "τ = τ_ff + (1 + p) k_p (q_ref − q) + (1 + d) k_d (v_ref − v)"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 8.5"
    sentence = "The servo of {joints} is softer or stiffer than the simulator's."
    remedy = "Set the simulator's servo gains to the fitted ones."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Zero: motion and torque agree."""
        return np.zeros((len(motion.t), 1, 2))

    @property
    def actuator(self) -> Mapping[str, float]:
        """See :attr:`Instant.actuator`."""
        return {name: 1.0 + self.values[name] for name in ("stiffness", "damping")}
