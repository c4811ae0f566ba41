"""A drive that cannot give all the torque that is asked of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.effect import Body, Effect, Port, Quantity
from hybrid.effects.instant import Memory, Scalar
from hybrid.signals import Motion

_CLIPS = 0.9  # loss from which a drive gives no more, whatever it is asked for
_TOTAL = 0.8  # the same that a fit finds, at least, of one that does
_NEAR = 0.2  # of the limit: how far from it a drive that clips delivers, at most
_SELDOM = 0.1  # of the samples, at which it may not
_MOVING = 0.05  # of the highest speed; at rest friction holds what it gets
_ENOUGH = 100  # samples below the limit, or beyond, to learn from
_CLEARLY, _HIGH = 1.1, 0.9  # times what is delivered in this part of the time


class Saturation(Effect):
    """Of the torque beyond a limit a part is lost: all of it, if the drive clips.

    A smaller part is iron in saturation, whose torque constant falls at high current.
    The log shows the torque asked for, and only that tells by how much it went beyond.
    """

    id = "saturation"
    port = Port.DRIVE
    becomes = "limit", "lower", "torque_gain"
    gains = (Quantity("loss", "", 0.5, 0.0, 1.0, spread=5.0),)
    shapes = (
        Quantity("limit", "N·m", 0.3, 0.02, 2.0, per=(1, 0)),
        # Whether a fit takes the drive to clip, and looks at the torque asked for.
        Quantity("total", "", 0.0, 0.0, 1.0, whole=True, inner=True),
    )
    equation = "τ_reported = τ_delivered + p · (τ_reported − clip(τ_reported, ±L))"
    source = "Siciliano et al. 2009, doi 10.1007/978-1-84628-642-1, section 5.2"
    sentence = "The drive of {joints} delivers less than it reports of high torques."
    remedy = "Set the actuator's force range, and plan motions below it."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Torque beyond the limit, where it is measured; see :meth:`Effect.columns`.

        Of a drive that clips the torque delivered tells nothing but that it is at the
        limit, or nearly, whenever more is asked for.
        """
        tau = motion.tau[:, self.joints]
        if not self.values["total"] or motion.asked is None:
            return np.nan_to_num(self._beyond(tau))[:, :, None]
        beyond = self._beyond(motion.asked[:, self.joints])
        return beyond[:, :, None] * float(self.holds(motion))

    @classmethod
    def suggested(cls, motions: Sequence[Motion], j: int) -> Mapping[str, float]:
        """The torque that is delivered where clearly more is asked for, if it often is.

        A drive that clips is no such one at other limits than near its own.
        """
        both = [
            (m.tau[m.mask, j], m.asked[m.mask, j])
            for m in motions if m.asked is not None
        ]  # fmt: skip
        delivered, asked = np.abs(np.concatenate([np.zeros((2, 0)), *both], axis=1))
        if len(asked) < _ENOUGH:
            return {}
        more = asked > _CLEARLY * np.quantile(delivered, _HIGH)
        if more.sum() < _ENOUGH:
            return {}
        return {"limit": float(np.median(delivered[more])), "total": 1.0}

    def holds(self, motion: Motion) -> bool:
        """Whether a drive that clips delivers its limit when more is asked for."""
        if not self.values["total"] or motion.asked is None:
            return True
        asked, tau, v = (
            x[:, self.joints] for x in (motion.asked, motion.tau, motion.v)
        )
        tau = self._delivered(motion, asked, tau)
        limit, moves = self.values["limit"], np.abs(v) > _MOVING * np.abs(v).max()
        over = moves & (np.abs(asked) > limit)
        apart = np.abs(np.sign(asked) * tau - limit) > _NEAR * limit
        return bool((over & apart).sum() <= _SELDOM * over.sum())

    @property
    def least_gains(self) -> Array:
        """Of a drive that clips all is lost; shape (1,)."""
        return np.array([_TOTAL * self.values["total"]])

    def as_reported(self) -> Saturation:
        """Beyond the limit p/(1 − p) of what is delivered is lost."""
        gain = self.values["loss"]
        if self.values["total"]:
            return self.at({"loss": gain, "total": 0.0})
        return self.at({"loss": gain / (1.0 + gain)})

    @property
    def actuator(self) -> Mapping[str, float]:
        """See :attr:`Instant.actuator`."""
        clips = self.values["loss"] > _CLIPS
        return {"limit": self.values["limit"]} if clips else {}

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

    def _delivered(self, motion: Motion, asked: Array, tau: Array) -> Array:
        """The file's torque (M, p), and friction and a rotor that the file may lack.

        These are learnt where less than the limit is asked for, and delivered.
        """
        out = np.array(tau)
        for k, j in enumerate(self.joints):
            v, lacks = motion.v[:, j], asked[:, k] - tau[:, k]
            laws = np.stack([np.sign(v), v, motion.a[:, j]], axis=1)
            moves = (np.abs(v) > _MOVING * np.abs(v).max()) & np.isfinite(lacks)
            below = moves & (np.abs(asked[:, k]) < self.values["limit"])
            if below.sum() >= _ENOUGH:
                fit = np.linalg.lstsq(laws[below], lacks[below], rcond=None)
                out[:, k] += laws @ fit[0]
        return out

    def _beyond(self, torque: Array) -> Array:
        limit = self.values["limit"]
        return torque - np.clip(torque, -limit, limit)
