"""A dead zone of the drive for small torques."""

from collections.abc import Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Memory, Port, Quantity, Scalar
from hybrid.effects.delivered import Drive
from hybrid.signals import Motion

# Slope of the law within the zone when it is inverted, so that the commanded torque
# has no jumps.
_INVERSE_SLOPE = 0.05
_LEAST_LOST = 0.8  # of the onset: torque that is lost
_MOST_DELIVERED = 0.2  # torque within the zone, of its width and of that outside
_LEAST_OUTSIDE = 0.5  # of the time: the torque is outside the zone
_MOST_INSIDE = 0.15  # of the time: a controller leaves the zone soon


class Deadzone(Effect):
    """The drive loses the first ±w of any torque.

    The log shows the commanded torque, which is larger than the delivered one by w. So
    the effect looks like dry friction with the sign of the torque instead of the speed.
    """

    id = "deadzone"
    port = Port.DRIVE
    gains = (Quantity("width", "N·m", 0.02, 0.0, 0.3, per=(1, 0)),)
    shapes = (
        # Torque over which a fit smooths the sign.
        Quantity("onset", "N·m", 0.005, 0.0005, 0.3, per=(1, 0), inner=True),
        # Whether a fit assumes that torque within the zone is lost.
        Quantity("total", "", 0.0, 0.0, 1.0, whole=True, inner=True),
    )
    equation = "τ_reported = τ_delivered + clip(τ_reported, ±w)"
    source = "Tao and Kokotovic 1994, doi 10.1109/9.273339"
    sentence = "The drive of {joints} delivers nothing for small torques."
    remedy = "Add the dead zone's width to the commanded torque, in its direction."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Direction of the torque; see :meth:`Effect.columns`.

        Where nothing comes through, only the commanded torque shows it. Else the
        delivered torque shows it too, without the noise of the measured one.
        """
        drive = Drive.of(motion, self.joints[0])
        torque = drive.asked
        if not self.values["total"]:
            torque = drive.delivered(motion.mask & drive.moving)
        direction = np.clip(torque / self.values["onset"], -1.0, 1.0)
        return np.nan_to_num(direction)[:, None, None]

    def holds(self, motions: Sequence[Motion]) -> bool:
        """Whether torque is outside the zone mostly, or nothing comes through.

        Else its direction looks like a gain. So that it is not just that of friction,
        the torque of the file has to be outside, too.
        """
        if any(m.asked is None for m in motions):
            return True
        drives = [Drive.of(m, self.joints[0]) for m in motions]
        moves = [m.mask & x.moving for m, x in zip(motions, drives, strict=True)]
        pairs = zip(drives, moves, strict=True)
        if self.values["total"]:
            parts = [np.array(x)[:, use] for x, use in pairs]
            return self._nothing_comes_through(Drive(*np.concatenate(parts, axis=1)))
        each = [np.abs([x.tau, x.delivered(use)])[:, use] for x, use in pairs]
        lower = np.concatenate(each, axis=1).min(axis=0)
        outside = (lower > self.values["onset"]).sum()
        return bool(outside > _LEAST_OUTSIDE * len(lower))

    def _nothing_comes_through(self, drive: Drive) -> bool:
        """Whether nothing is delivered in the zone, which a controller leaves soon."""
        asked, onset = drive.asked, self.values["onset"]
        inside = np.abs(asked) < onset
        if not 0 < inside.sum() < _MOST_INSIDE * len(inside):
            return False
        delivered = np.abs(drive.delivered(~inside, np.sign(asked)))
        least, usual = (np.median(delivered[x]) for x in (inside, ~inside))
        return bool(least < _MOST_DELIVERED * min(usual, onset))

    @property
    def least_gains(self) -> Array:
        """Nearly the onset, shape (1,): smoothed over more, the sign is a gain."""
        return np.array([_LEAST_LOST * self.values["onset"]])

    def deliver(self, torque: Array) -> Array:
        """Delivered torque for a commanded one."""
        width = self.values["width"]
        return torque - np.clip(torque, -width, width)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """Commanded torque for a delivered one: the inverse of ``deliver``."""
        (needed,), width = torque, self.values["width"]
        return [needed + np.clip(needed / _INVERSE_SLOPE, -width, width)], ()
