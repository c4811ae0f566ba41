"""A drive that cannot give all the torque that is asked of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybrid.effects.effect import Array, Body, Effect, Port, Quantity
from hybrid.effects.instant import Memory, Scalar
from hybrid.signals import Motion

_CLIPS = 0.9  # loss from which a drive gives no more, whatever it is asked for


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

    def as_reported(self) -> Saturation:
        """Beyond the limit p/(1 − p) of what is delivered is lost."""
        gain = self.values["loss"]
        return self.at({"loss": gain / (1.0 + gain)})

    def deliver(self, torque: Array) -> Array:
        """Torque delivered for one asked for."""
        return torque - self.values["loss"] * self._beyond(torque)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """What to ask for so that a torque is delivered: the inverse of ``deliver``.

        A drive that clips is asked for no more than is needed.
        """
        (needed,), loss, limit = torque, self.values["loss"], self.values["limit"]
        share = loss / (1.0 - loss) if loss < _CLIPS else 0.0
        beyond = needed - np.clip(needed, -limit, limit)
        return [needed + share * beyond], ()

    def _beyond(self, torque: Array) -> Array:
        limit = self.values["limit"]
        return torque - np.clip(torque, -limit, limit)
