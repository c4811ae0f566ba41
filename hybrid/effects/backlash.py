"""Backlash between motor and link."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.effects import Body, Effect, Port, Quantity, Spec
from hybrid.signals import Motion

_CONTACT_TIME = 0.002  # s, of simulated teeth; the least at MuJoCo's usual step
_USUAL_FLIGHT = 64  # samples
# Standard deviation of the filter, in s: differentiated positions spread an impact over
# this time.
_IMPACT_WIDTH = 0.011
# Inertia between backlash and motor, as a share of the rotor's. Without it, a gear with
# elasticity would have a massless part.
_GEAR_INERTIA = 0.01
_SOFT_SHARE = 0.1  # of half the gap, over which simulated teeth become hard


class Backlash(Effect):
    """A gap between motor and link, half of it on either side.

    The encoder is at the motor. While the load presses the link against one side of the
    gap, the link follows the motor. When the load changes its sign, the link moves
    freely across the gap and stays at the other side.
    """

    id = "backlash"
    port = Port.TRANSMISSION
    shows_in_motion = True
    rough = 0.4
    not_in_loop = "it needs the load that comes next, to know when the gap is crossed"
    steep = True
    behind = "play"
    inexact = {"half_width": 0.1}  # softness of stops
    gains = (Quantity("half_width", "rad", 0.001, 0.0, 0.01),)
    equation = "τ = rigid(θ + d); d = −b sgn(τ_load) at a stop, d̈ = −τ_load/M between"
    source = "Nordin and Gutman 2002, doi 10.1016/S0005-1098(02)00047-X"
    sentence = "The gear of {joints} has play."
    remedy = "Add a limited play joint behind the motor, or preload the gear."

    def columns(self, motion: Motion, body: Body) -> Array:
        """Change of torque over half of the gap, at its width or the usual one.

        See :meth:`Effect.columns`; shape (N, n, 1). It is not linear for any width,
        since the time to cross a gap grows with its cube root.
        """
        half = self.values["half_width"]
        half = half if half > 0 else self.gains[0].typical
        change = self._play(motion, body, half) / half
        return body.response(self.joints[0], *change)[:, :, None]

    def observe(self, motion: Motion, body: Body) -> Motion:
        """The motion of the link."""
        half = self.values["half_width"]
        if half <= 0:
            return motion
        own = np.eye(motion.q.shape[1])[self.joints[0]]
        dq, dv, da = self._play(motion, body, half)[:, :, None] * own
        return replace(motion, q=motion.q + dq, v=motion.v + dv, a=motion.a + da)

    def _play(self, motion: Motion, body: Body, half: float) -> Array:
        """Position, speed and acceleration of the link less the motor's, (3, N)."""
        (j,) = self.joints
        inertia = body.slopes(j)[2][:, j]
        step = float(np.median(np.diff(motion.t)))
        acceleration = body.load[:, j] / np.maximum(inertia, 1e-9)
        from scipy.ndimage import gaussian_filter1d

        smooth = gaussian_filter1d(acceleration, _IMPACT_WIDTH / step)
        where = _link_position(smooth, half, step)
        wide = np.pad(where, 1, mode="edge")
        speed = (wide[2:] - wide[:-2]) / (2 * step)
        return np.stack([where, speed, (wide[2:] - 2 * where + wide[:-2]) / step**2])

    def edit_spec(self, spec: Spec, names: Sequence[str]) -> None:
        """Add a free joint between stops after the motor joint, on the same axis."""
        half = self.values["half_width"]
        if half <= 0:
            return
        name = names[self.joints[0]]
        play = self.added_joint(spec, name)
        play.armature = _GEAR_INERTIA * spec.joint(name).armature
        play.limited, play.range = True, np.array([-half, half])
        play.solref_limit = np.array([_CONTACT_TIME, 1.0])
        play.solimp_limit[:3] = 0.99, 0.999, _SOFT_SHARE * half


def set_play(model: Any, joints: Index, half: Array, rotor: Array) -> None:
    """Set other gaps in a compiled model of :meth:`Backlash.edit_spec`.

    Half of each gap [rad] and the inertia of each rotor [kg·m²] have the shape (K,), as
    the joints behind the motors.
    """
    model.dof_armature[joints] = _GEAR_INERTIA * rotor
    model.jnt_range[joints] = np.stack([-half, half], axis=1)
    model.jnt_solimp[joints, 2] = _SOFT_SHARE * half


def _link_position(acceleration: Array, half: float, step: float) -> Array:
    """Position of a link between its stops, shape (N,), [rad].

    The stops must give it an acceleration, shape (N,), [rad/s²].
    """
    up = acceleration >= 0
    away = {1: np.flatnonzero(~up), -1: np.flatnonzero(up)}  # from each of the stops
    where, now, side = np.empty(len(acceleration)), 0, 1 if up[0] else -1
    # Loop over flights from stop to stop.
    while now < len(acceleration):
        later = away[side][np.searchsorted(away[side], now) :]
        start = int(later[0]) if len(later) else len(acceleration)
        where[now:start] = -half * side
        path, landed = _flight(-side * acceleration[start:], half, step)
        now = start + len(path)
        where[start:now] = side * (path - half)
        side = -side if landed else side
    return where


def _flight(fall: Array, half: float, step: float) -> tuple[Array, bool]:
    """Distance from one stop, shape (K,), [rad], and whether it reaches the other."""
    length = _USUAL_FLIGHT
    while True:
        path = fall[:length].cumsum().cumsum() * step**2
        out = np.flatnonzero((path >= 2 * half) | (path < 0))
        if len(out):
            return path[: out[0]], bool(path[out[0]] > 0)
        if length >= len(fall):
            return path, False
        length *= 2
