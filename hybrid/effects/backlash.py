"""Lost motion between motor and link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from hybrid.arrays import Array
from hybrid.effects.effect import Body, Effect, Port, Quantity
from hybrid.errors import EffectError
from hybrid.signals import Motion

if TYPE_CHECKING:
    import mujoco

# The teeth of a simulated gear meet as hard as MuJoCo's usual step allows.
_CONTACT_TIME = 0.002  # s
_USUAL_FLIGHT = 64  # samples
# The knock of a landing turns the motor as well. Accelerations made from positions
# smear it over the end of the flight, which is smoothed by as much, s.
_SMEAR = 0.011
# Inertia of what lies between play and motor, of the rotor's: a gear that twists as
# well would otherwise have a massless part between its spring and its stops.
_GEAR = 0.01


class Backlash(Effect):
    """Between motor and link is a gap: half of it lies to either side.

    The encoder sits on the motor. While the load presses the link to a stop it follows
    the motor; when the load changes its sign the link is free, falls across the gap,
    and stays where it strikes.
    """

    id = "backlash"
    port = Port.TRANSMISSION
    shows_in_motion = True
    rough = 0.4
    not_in_loop = "it needs the load that comes next, to know when the gap is crossed"
    steep = True
    behind = "play"
    inexact: ClassVar[Mapping[str, float]] = {"half_width": 0.1}  # how soft stops are
    gains = (Quantity("half_width", "rad", 0.001, 0.0, 0.01),)
    equation = "τ = rigid(θ + d); d = −b sgn(τ_load) at a stop, d̈ = −τ_load/M between"
    source = "Nordin and Gutman 2002, doi 10.1016/S0005-1098(02)00047-X"
    sentence = "The gear of {joints} has play."
    remedy = "Add a limited play joint behind the motor, or preload the gear."

    def reaches(self, size: int) -> tuple[int, ...]:
        """The whole arm: all of it moves when a link lags."""
        return tuple(range(size))

    def columns(self, motion: Motion, body: Body) -> Array:
        """Change of torque over the play, at its width or else at the usual one.

        See :meth:`Effect.columns`; shape (N, n, 1). No width is small enough for it to
        be linear: a gap is crossed in a time that goes with its cube root.
        """
        half = self.values["half_width"] or self.gains[0].typical
        dq, dv, da = self._play(motion, body, half)
        return body.response(dq / half, dv / half, da / half)[:, :, None]

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link behind the play."""
        half = self.values["half_width"]
        if half <= 0:
            return motion
        dq, dv, da = self._play(motion, body, half)
        return replace(motion, q=motion.q + dq, v=motion.v + dv, a=motion.a + da)

    def _play(self, motion: Motion, body: Body, half: float) -> tuple[Array, ...]:
        """Position, speed and acceleration of the link over the motor's, (N, n)."""
        (j,) = self.joints
        inertia = body.slopes(j)[2][:, j]
        step = float(np.median(np.diff(motion.t)))
        pull = body.load[:, j] / np.maximum(inertia, 1e-9)
        from scipy.ndimage import gaussian_filter1d

        where = _fall(gaussian_filter1d(pull, _SMEAR / step), half, step)
        wide = np.pad(where, 1, mode="edge")
        out = np.zeros((3, *motion.q.shape))
        out[0, :, j] = where
        out[1, :, j] = (wide[2:] - wide[:-2]) / (2 * step)
        out[2, :, j] = (wide[2:] - 2 * where + wide[:-2]) / step**2
        return tuple(out)

    def edit_spec(self, spec: mujoco.MjSpec, names: Sequence[str]) -> None:
        """Add a free joint between stops behind the motor joint, on the same axis.

        Raises:
            EffectError: The joint has no armature: the rotor would be massless.
        """
        half = self.values["half_width"]
        if half <= 0:
            return
        name = names[self.joints[0]]
        motor = spec.joint(name)
        if motor.armature <= 0:
            raise EffectError(
                f"backlash at {name!r} needs a rotor: add the armature effect first"
            )
        play = spec.body(name).add_joint(
            name=f"{name}/{self.behind}", type=motor.type, axis=motor.axis
        )
        play.armature = _GEAR * motor.armature
        play.limited, play.range = True, np.array([-half, half])
        play.solref_limit = np.array([_CONTACT_TIME, 1.0])
        play.solimp_limit[:3] = 0.99, 0.999, 0.1 * half


def _fall(pull: Array, half: float, step: float) -> Array:
    """Place of a link between its stops, shape (N,), [rad].

    Args:
        pull: Acceleration that the motor has to give to the link, shape (N,), [rad/s²].
        half: Half of the gap, [rad].
        step: Time between samples, [s].
    """
    up = pull >= 0
    away = {1: np.flatnonzero(~up), -1: np.flatnonzero(up)}  # from each of the stops
    where, now, side = np.empty(len(pull)), 0, 1 if up[0] else -1
    # Only the flights are walked through, one by one.
    while now < len(pull):
        later = away[side][np.searchsorted(away[side], now) :]
        start = int(later[0]) if len(later) else len(pull)
        where[now:start] = -half * side
        path, landed = _flight(-side * pull[start:], half, step)
        now = start + len(path)
        where[start:now] = side * (path - half)
        side = -side if landed else side
    return where


def _flight(fall: Array, half: float, step: float) -> tuple[Array, bool]:
    """Way from one stop, shape (K,), [rad], and whether it ends at the other."""
    length = _USUAL_FLIGHT
    while True:
        path = fall[:length].cumsum().cumsum() * step**2
        out = np.flatnonzero((path >= 2 * half) | (path < 0))
        if len(out):
            return path[: out[0]], bool(path[out[0]] > 0)
        if length >= len(fall):
            return path, False
        length *= 2
