"""A log as few samples of position, speed, acceleration and torque."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.recording import Recording
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
            NaN at joints without one, None without any.
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    logged: Array | None = None
    relaxed: Array | None = None


def sampled(recording: Recording) -> State:
    """Filter, differentiate and decimate a log on a uniform clock.

    The clock itself is in question. The band of the motion is therefore sought as if
    samples came at a usual rate, which gives the same samples whatever the unit of
    time.
    """
    samples = len(recording.t)
    pretended = replace(recording, t=np.arange(samples) / _PRETENDED)
    cutoff = choose_cutoff(pretended)
    rate = (samples - 1) / recording.duration

    def smooth(x: Array, cutoff: float) -> Array:
        return butterworth(x, rate=_PRETENDED, cutoff=cutoff)

    edge = min(samples // 10, int(_EDGE * _PRETENDED / cutoff) + 4)
    rows = np.linspace(edge, samples - 1 - edge, min(_MOST, samples - 2 * edge))
    kept = np.unique(rows.astype(int))
    # Wider than the torque's: differences follow, and all pass the same filter then.
    q = smooth(recording.q, 2 * cutoff)
    v = central_difference(q, rate=rate, accuracy=4)
    a = central_difference(v, rate=rate, accuracy=4)
    channels = [q, v, a, recording.tau if recording.has_torque else np.zeros_like(q)]
    if recording.v is not None:
        channels.append(recording.v)
    return State(*(smooth(x, cutoff)[kept] for x in channels))
