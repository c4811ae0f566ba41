"""Latency of the command."""

from collections.abc import Mapping

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Port, Quantity
from hybrid.signals import Motion


class CommandLatency(Effect):
    """The controller receives the command with a delay T.

    This changes the torque for a command, but not the torque for a motion.
    """

    id = "command_latency"
    port = Port.COMMAND
    shifts = True
    not_in_loop = "it lies between command and torque"
    gains = (Quantity("time", "s", 0.01, 0.0, 0.2),)
    equation = "τ(t) = τ_ff(t − T) + k_p (q_ref(t − T) − q) + k_d (v_ref(t − T) − v)"
    source = "Tan et al. 2018, doi 10.15607/RSS.2018.XIV.010"
    sentence = "Commands to {joints} act late."
    remedy = "Delay the command in the simulator by the fitted time."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Zero: motion and torque agree."""
        return np.zeros((len(motion.t), 1, 1))

    @property
    def actuator(self) -> Mapping[str, float]:
        """See :attr:`Instant.actuator`."""
        return {"latency": self.values["time"]} if self.values["time"] > 0 else {}
