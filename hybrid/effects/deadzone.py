"""A drive that does nothing with a small torque."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.effect import Body, Effect, Port, Quantity
from hybrid.effects.instant import Memory, Scalar
from hybrid.signals import Motion

# Share of torque that is taken to get through: the zone is then crossed within this
# share of its width, and not by jumps of the commanded torque.
_LEAST = 0.05
_ALL = 0.8  # of the width; of smaller torques a drive loses that much, at least
# Of the width and of what is delivered elsewhere: what a dead zone lets through.
_NOTHING = 0.2
_OFTEN = 0.5  # of the time: torque is delivered
_CROSSING = 0.15  # of the time: most that a controller stays within it
_MOVING = 0.05  # of the highest speed; at rest friction holds what it gets


class Deadzone(Effect):
    """Of any torque the first ±w are lost.

    The log shows the torque asked for: more than is delivered by w, in its direction,
    so that it looks like dry friction that follows the sign of torque, not of speed.
    """

    id = "deadzone"
    port = Port.DRIVE
    gains = (Quantity("width", "N·m", 0.02, 0.0, 0.3, per=(1, 0)),)
    shapes = (
        # Torque over which a fit takes it to set in: what it knows torque to.
        Quantity("onset", "N·m", 0.005, 0.0005, 0.3, per=(1, 0), inner=True),
        # Whether a fit looks at the torque asked for.
        Quantity("total", "", 0.0, 0.0, 1.0, whole=True, inner=True),
    )
    equation = "τ_reported = τ_delivered + clip(τ_reported, ±w)"
    source = "Tao and Kokotovic 1994, doi 10.1109/9.273339"
    sentence = "The drive of {joints} delivers nothing for small torques."
    remedy = "Add the dead zone's width to the commanded torque, in its direction."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Direction of the torque, where it is measured; see :meth:`Effect.columns`.

        Torque delivered has one unless it is nothing, or nearly, whenever less is asked
        for; then only the torque asked for tells. A controller soon asks for more: a
        joint that is hardly ever asked for more than that has another ail.
        """
        tau, onset = motion.tau[:, self.joints], self.values["onset"]
        if motion.asked is None:
            return np.nan_to_num(self._direction(tau))[:, :, None]
        asked, v = motion.asked[:, self.joints], np.abs(motion.v[:, self.joints])
        moves = v > _MOVING * v.max()
        if not self.values["total"]:
            there = (np.abs(tau) > onset) & moves  # or else it is a gain
            often = there.sum() > _OFTEN * moves.sum()
            return self._direction(tau)[:, :, None] * float(often)
        inside, outside = moves & (np.abs(asked) < onset), moves & (abs(asked) >= onset)
        sure = inside.any() and inside.sum() < _CROSSING * moves.sum()
        if sure:
            least, usual = (np.median(np.abs(tau[x])) for x in (inside, outside))
            sure = least < _NOTHING * min(usual, onset)
        return self._direction(asked)[:, :, None] * float(sure)

    @property
    def least_gains(self) -> Array:
        """Where torque within the zone is looked at, it is lost; shape (1,)."""
        return np.array([_ALL * self.values["onset"] * self.values["total"]])

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        width = self.values["width"]
        return torque - np.clip(torque, -width, width)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """What to ask for so that a torque is delivered: the inverse of ``deliver``."""
        (needed,), width = torque, self.values["width"]
        return [needed + np.clip(needed / _LEAST, -width, width)], ()

    def _direction(self, torque: Array) -> Array:
        return np.clip(torque / self.values["onset"], -1.0, 1.0)
