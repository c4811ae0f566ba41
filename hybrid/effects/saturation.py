"""A drive that cannot give all the torque that is asked of it."""

from __future__ import annotations

import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.signals import Motion


class Saturation(Effect):
    """Of the torque beyond a limit a part is lost: all of it, if the drive clips.

    A smaller part is iron in saturation, whose torque constant falls at high current.
    The log shows the torque asked for, and only that tells by how much it went beyond.
    """

    id = "saturation"
    port = Port.DRIVE
    gains = (Quantity("loss", "", 0.5, 0.0, 1.0),)
    shapes = (Quantity("limit", "N·m", 0.3, 0.02, 2.0, per=(1, 0)),)
    equation = "τ_reported = τ_delivered + p · (τ_reported − clip(τ_reported, ±L))"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 5.2"
    sentence = "The drive of {joints} delivers less than it reports of high torques."
    remedy = "Set the actuator's force range, and plan motions below it."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque beyond the limit, where it is measured; see :meth:`Effect.columns`."""
        return np.nan_to_num(self._beyond(motion.tau[:, self.joints]))[:, :, None]

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        return torque - self.values["loss"] * self._beyond(torque)

    def _beyond(self, torque: Array) -> Array:
        limit = self.values["limit"]
        return torque - np.clip(torque, -limit, limit)
