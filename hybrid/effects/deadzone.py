"""A drive that does nothing with a small torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.effects.instant import Memory, Scalar
from hybrid.signals import Motion

# Least share of torque that is taken to get through: a true dead zone is then crossed
# within this share of its width, and not by jumps of the commanded torque.
_LEAST = 0.05


class Deadzone(Effect):
    """Of the torque within ±w a part is lost: all of it in a true dead zone.

    The log shows the torque asked for. Beyond ±w the loss stays what it is there, so
    that it looks like dry friction that follows the sign of torque, not of speed.
    """

    id = "deadzone"
    port = Port.DRIVE
    gains = (Quantity("loss", "", 1.0, 0.0, 1.0),)
    shapes = (Quantity("width", "N·m", 0.02, 0.0005, 0.3, per=(1, 0)),)
    equation = "τ_reported = τ_delivered + p · clip(τ_reported, ±w)"
    source = "Tao and Kokotovic 1994, doi 10.1109/9.273339"
    sentence = "The drive of {joints} delivers nothing for small torques."
    remedy = "Add the dead zone's width to the commanded torque, in its direction."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque within the zone, where it is measured; see :meth:`Effect.columns`."""
        return np.nan_to_num(self._within(motion.tau[:, self.joints]))[:, :, None]

    def as_reported(self) -> Deadzone:
        """Up to (1 − p)·w delivered, p/(1 − p) of it is lost."""
        gain, width = self.values["loss"], self.values["width"]
        return self.at({"loss": gain / (1.0 + gain), "width": width * (1.0 + gain)})

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        return torque - self.values["loss"] * self._within(torque)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """What to ask for so that a torque is delivered: the inverse of ``deliver``."""
        (needed,), loss, width = torque, self.values["loss"], self.values["width"]
        through = max(1.0 - loss, _LEAST)
        return [needed + loss * np.clip(needed / through, -width, width)], ()

    def _within(self, torque: Array) -> Array:
        width = self.values["width"]
        return np.clip(torque, -width, width)
