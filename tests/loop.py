"""The position controller: from command to commanded torque."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.effects import Effect


@dataclass(frozen=True, eq=False)
class Loop:
    """What a position controller is asked, what it sees, and its gains.

    Attributes:
        t: Time, shape (N,), [s].
        q_ref: Commanded position, shape (N, n), [rad].
        v_ref: Commanded speed, shape (N, n), [rad/s].
        feedforward: Torque fed forward, shape (N, n), [N·m].
        q: Position that the encoders show, shape (N, n), [rad].
        v: Speed that the encoders show, shape (N, n), [rad/s].
        kp: Stiffness, shape (n,), [N·m/rad].
        kd: Damping, shape (n,), [N·m·s/rad].
    """

    t: Array
    q_ref: Array
    v_ref: Array
    feedforward: Array
    q: Array
    v: Array
    kp: Array
    kd: Array


def commanded_torque(loop: Loop, effects: Sequence[Effect] = ()) -> Array:
    """Torque that the drives are asked for, to compare with the log's, (N, n), [N·m].

    An effect between command and torque leaves no trace in the rigid body's residual.
    Here it does: a fit finds its gains from the difference of this and the log. Effects
    that act elsewhere change nothing.
    """
    for effect in effects:
        actuator, changed = effect.actuator, {}
        for name in ("q_ref", "v_ref", "feedforward"):
            signal = getattr(loop, name).copy()
            for j in effect.joints:
                late = loop.t - actuator.get("latency", 0.0)
                signal[:, j] = np.interp(late, loop.t, signal[:, j])
            changed[name] = signal
        kp, kd, j = loop.kp.copy(), loop.kd.copy(), list(effect.joints)
        kp[j] *= actuator.get("stiffness", 1.0)
        kd[j] *= actuator.get("damping", 1.0)
        loop = replace(loop, kp=kp, kd=kd, **changed)
    off, slower = loop.q_ref - loop.q, loop.v_ref - loop.v
    return loop.feedforward + loop.kp * off + loop.kd * slower
