"""Saturation of the drive torque."""

from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Body, Effect, Memory, Port, Quantity, Scalar
from hybrid.effects.delivered import Drive
from hybrid.signals import Motion

_CLIPPED = 0.9  # loss from which a drive counts as clipping
_LEAST_CLIPPED = 0.8  # smallest fitted loss of a drive that clips
_LIMIT_TOLERANCE = 0.2  # of the limit: deviation of the torque of a drive that clips
_MOST_OUTSIDE = 0.1  # of the samples beyond that tolerance
_FEWEST_SAMPLES = 100  # beyond the limit, for a fit
_ESTIMATES = 2  # of the limit: by the file's torque, and with what that lacks
# A command above this multiple of this quantile of the delivered torque is beyond it.
_ASKED_MORE, _HIGH_QUANTILE = 1.1, 0.9


class Saturation(Effect):
    """A share of the torque beyond a limit is lost: all of it, if the drive clips.

    A smaller share comes from iron saturation, where the torque constant falls at high
    current. The log shows the commanded torque, which alone shows the excess.
    """

    id = "saturation"
    port = Port.DRIVE
    becomes = "limit", "lower", "torque_gain"
    inexact = {"limit": 0.005}  # clipped before it is filtered
    gains = (Quantity("loss", "", 0.5, 0.0, 1.0, spread=5.0),)
    shapes = (
        Quantity("limit", "N·m", 0.3, 0.02, 2.0, per=(1, 0)),
        # Whether a fit assumes that the drive clips, and uses the commanded torque.
        Quantity("total", "", 0.0, 0.0, 1.0, whole=True, inner=True),
    )
    equation = "τ_reported = τ_delivered + p · (τ_reported − clip(τ_reported, ±L))"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 5.2"
    sentence = "The drive of {joints} delivers less than it reports of high torques."
    remedy = "Set the actuator's force range, and plan motions below it."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque beyond the limit; see :meth:`Effect.columns`.

        The delivered torque of a drive that clips does not show the excess, only that
        it is near the limit whenever the commanded torque is beyond it.
        """
        tau = motion.tau[:, self.joints]
        if not self.values["total"] or motion.asked is None:
            return np.nan_to_num(self._beyond(tau))[:, :, None]
        return self._beyond(motion.asked[:, self.joints])[:, :, None]

    @classmethod
    def suggested(cls, motions: Sequence[Motion], j: int) -> Mapping[str, float]:
        """The median delivered torque while the commanded torque is clearly larger.

        The law of a drive that clips fits only near its own limit. The file's torque
        may lack friction and rotor: these are fitted below a first estimate of it.
        """
        logs = [(Drive.of(m, j), m.mask) for m in motions if m.asked is not None]
        if not logs:
            return {}
        asked = np.concatenate([drive.asked[use] for drive, use in logs])
        delivered, limit = [drive.tau for drive, _ in logs], np.inf
        for _ in range(_ESTIMATES):
            each = zip(delivered, logs, strict=True)
            tau = np.concatenate([x[use] for x, (_, use) in each]) * np.sign(asked)
            quantile = np.quantile(np.abs(tau), _HIGH_QUANTILE) if len(tau) else np.inf
            beyond = np.abs(asked) > _ASKED_MORE * quantile
            if beyond.sum() < _FEWEST_SAMPLES:
                break
            limit = float(np.median(tau[beyond]))
            delivered = [
                drive.delivered(drive.moving & (np.abs(drive.asked) < limit))
                for drive, _ in logs
            ]
        return {"limit": limit, "total": 1.0} if 0 < limit < np.inf else {}

    def holds(self, motions: Sequence[Motion]) -> bool:
        """Whether a drive that clips delivers its limit when the command is beyond."""
        if not self.values["total"]:
            return True
        count, limit = np.zeros(2), self.values["limit"]
        for motion in (m for m in motions if m.asked is not None):
            drive = Drive.of(motion, self.joints[0])
            moves, asked = drive.moving, drive.asked
            tau = drive.delivered(moves & (np.abs(asked) < limit))
            over = moves & (np.abs(asked) > limit)
            apart = np.abs(np.sign(asked) * tau - limit) > _LIMIT_TOLERANCE * limit
            count += (over & apart).sum(), over.sum()
        return bool(count[0] <= _MOST_OUTSIDE * count[1])

    @property
    def least_gains(self) -> Array:
        """A drive that clips loses nearly all of the excess; shape (1,)."""
        return np.array([_LEAST_CLIPPED * self.values["total"]])

    def as_reported(self) -> Self:
        """The loss p/(1 − p) of the delivered excess as the loss p of the reported."""
        gain = self.values["loss"]
        if self.values["total"]:
            return self.at({"loss": gain, "total": 0.0})
        return self.at({"loss": gain / (1.0 + gain)})

    @property
    def actuator(self) -> Mapping[str, float]:
        """See :attr:`Instant.actuator`."""
        clips = self.values["loss"] > _CLIPPED
        return {"limit": self.values["limit"]} if clips else {}

    def deliver(self, torque: Array) -> Array:
        """Delivered torque for a commanded one."""
        return torque - self.values["loss"] * self._beyond(torque)

    def report_at_instant(
        self, torque: Sequence[Scalar], memory: Memory, step: Scalar
    ) -> tuple[Sequence[Scalar], Memory]:
        """Commanded torque for a delivered one: the inverse of ``deliver``.

        For a drive that clips it is the delivered torque.
        """
        (needed,), loss, limit = torque, self.values["loss"], self.values["limit"]
        share = loss / (1.0 - loss) if loss < _CLIPPED else 0.0
        beyond = needed - np.clip(needed, -limit, limit)
        return [needed + share * beyond], ()

    def _beyond(self, torque: Array) -> Array:
        limit = self.values["limit"]
        return torque - np.clip(torque, -limit, limit)
