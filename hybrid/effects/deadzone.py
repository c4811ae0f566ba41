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
# Of the width and of what is delivered elsewhere: what a true dead zone lets through.
_NOTHING = 0.2
_OFTEN = 0.5  # of the time: torque is beyond a zone of which part gets through
_CROSSING = 0.15  # of the time: most that a controller stays within it
_MOVING = 0.05  # of the highest speed; at rest friction holds what it gets


class Deadzone(Effect):
    """Of the torque within ±w a part is lost: all of it in a true dead zone.

    The log shows the torque asked for. Beyond ±w the loss stays what it is there, so
    that it looks like dry friction that follows the sign of torque, not of speed.
    """

    id = "deadzone"
    port = Port.DRIVE
    gains = (Quantity("loss", "", 1.0, 0.0, 1.0, spread=5.0),)
    shapes = (
        Quantity("width", "N·m", 0.02, 0.0005, 0.3, per=(1, 0)),
        # Whether a fit takes all of it to be lost, and looks at the torque asked for.
        Quantity("total", "", 0.0, 0.0, 1.0, whole=True, inner=True),
    )
    equation = "τ_reported = τ_delivered + p · clip(τ_reported, ±w)"
    source = "Tao and Kokotovic 1994, doi 10.1109/9.273339"
    sentence = "The drive of {joints} delivers nothing for small torques."
    remedy = "Add the dead zone's width to the commanded torque, in its direction."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque within the zone, where it is measured; see :meth:`Effect.columns`.

        Of a true dead zone the torque delivered tells nothing but that it is nothing,
        or nearly, whenever less is asked for. A controller soon asks for more: a joint
        that is hardly ever asked for more than that has another ail.
        """
        tau, width = motion.tau[:, self.joints], self.values["width"]
        if motion.asked is None:
            return np.nan_to_num(self._within(tau))[:, :, None]
        asked, v = motion.asked[:, self.joints], np.abs(motion.v[:, self.joints])
        moves = v > _MOVING * v.max()
        if not self.values["total"]:
            left = (np.abs(tau) > width) & moves  # or else it is a gain
            often = left.sum() > _OFTEN * moves.sum()
            return self._within(tau)[:, :, None] * float(often)
        inside, outside = moves & (np.abs(asked) < width), moves & (abs(asked) >= width)
        sure = inside.any() and inside.sum() < _CROSSING * moves.sum()
        if sure:
            least, usual = (np.median(np.abs(tau[x])) for x in (inside, outside))
            sure = least < _NOTHING * min(usual, width)
        return self._within(asked)[:, :, None] * float(sure)

    def as_reported(self) -> Deadzone:
        """Up to (1 − p)·w delivered, p/(1 − p) of it is lost."""
        gain, width = self.values["loss"], self.values["width"]
        if self.values["total"]:
            return self.at({"total": 0.0})
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
