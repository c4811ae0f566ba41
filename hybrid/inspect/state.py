"""A log as few samples of position, speed, acceleration and torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.recording import Recording
from hybrid.robot import Robot
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import butterworth, central_difference

_MOST = 300  # samples: a hundred columns are told apart by a few times as many
_PRETENDED = 500.0  # Hz
_EDGE = 1.5  # periods of the cut-off


@dataclass(frozen=True, eq=False)
class State:
    """M samples of a log, below the cut-off of its positions.

    Attributes:
        q: Positions, shape (M, n), [rad or m].
        v: Speeds, shape (M, n), [rad/s or m/s].
        a: Accelerations, shape (M, n), [rad/s² or m/s²].
        tau: Torques, shape (M, n), [N·m or N].
        logged: Measured speeds, shape (M, n), or None.
        relaxed: Where springs of the robot file pull nothing, shape (n,), [rad or m];
            NaN at joints without one.
        rated: What the drives can hold, by the robot file, shape (n,), [N·m or N].
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    logged: Array | None
    relaxed: Array
    rated: Array


def sampled(recording: Recording, robot: Robot | None) -> State:
    """Filter, differentiate and decimate a log on a uniform clock.

    The clock itself is in question. The band of the motion is therefore sought as if
    samples came at a usual rate, which gives the same samples whatever the unit of
    time.
    """
    samples = len(recording.t)
    cutoff = choose_cutoff(replace(recording, t=np.arange(samples) / _PRETENDED))
    rate = (samples - 1) / recording.duration

    def smooth(x: Array, cutoff: float) -> Array:
        return butterworth(x, rate=_PRETENDED, cutoff=cutoff)

    edge = min(samples // 10, int(_EDGE * _PRETENDED / cutoff) + 4)
    rows = np.linspace(edge, samples - 1 - edge, min(_MOST, samples - 2 * edge))
    kept = np.unique(rows.astype(int))
    # Wider than the torque's: differences follow, and all pass the same filter then.
    q = smooth(recording.q, 2 * cutoff)
    v = central_difference(q, rate=rate)
    a = central_difference(v, rate=rate)
    tau = recording.tau if recording.has_torque else np.zeros_like(q)
    channels = [x if x is None else smooth(x, cutoff)[kept]
                for x in (q, v, a, tau, recording.v)]  # fmt: skip
    relaxed, rated = np.full(recording.size, np.nan), np.full(recording.size, np.inf)
    if robot is not None:
        relaxed = np.where(robot.stiffness > 0, robot.springref, np.nan)
        rated = robot.tau_max
    return State(*channels, relaxed, rated)  # type: ignore[call-arg,arg-type]
