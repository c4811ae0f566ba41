"""Filter, differentiate and decimate a log to a few hundred samples."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hybrid.arrays import Array
from hybrid.recording import Recording
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import butterworth, central_difference

_MOST_SAMPLES = 300  # enough to fit some hundred columns
_ASSUMED_RATE = 500.0  # Hz
_LAGS = -0.2, -0.1, 0.1, 0.2  # s; drives and buses delay by less
_EDGE = 1.5  # periods of the cut-off: transient of the filter


@dataclass(frozen=True, eq=False)
class State:
    """M low-pass filtered samples of a log.

    Attributes:
        q: Positions, shape (M, n), [rad or m].
        v: Speeds, shape (M, n), [rad/s or m/s].
        a: Accelerations, shape (M, n), [rad/s² or m/s²].
        tau: Torques, shape (M, n), [N·m or N].
        logged: Measured speeds, shape (M, n), or None.
        later: The torque some time later, by that time in [s], shape (M, n) each.
    """

    q: Array
    v: Array
    a: Array
    tau: Array
    logged: Array | None = None
    later: Mapping[float, Array] = field(default_factory=dict)


def filtered_state(recording: Recording) -> State:
    """Filter, differentiate and decimate a log on a uniform clock.

    The unit of time may be wrong. The cut-off is therefore chosen at an assumed rate,
    so that the same samples result in any unit.
    """
    samples = len(recording.t)
    cutoff = choose_cutoff(replace(recording, t=np.arange(samples) / _ASSUMED_RATE))
    rate = (samples - 1) / recording.duration

    def smooth(x: Array, cutoff: float) -> Array:
        return butterworth(x, rate=_ASSUMED_RATE, cutoff=cutoff)

    edge = min(samples // 10, int(_EDGE * _ASSUMED_RATE / cutoff) + 4)
    rows = np.linspace(edge, samples - 1 - edge, min(_MOST_SAMPLES, samples - 2 * edge))
    kept = np.unique(rows.astype(int))
    # Positions are differentiated first; the torque's cut-off follows for all.
    q = smooth(recording.q, 2 * cutoff)
    v = central_difference(q, rate=rate)
    a = central_difference(v, rate=rate)
    tau = recording.tau if recording.has_torque else np.zeros_like(q)
    tau = smooth(tau, cutoff)
    q, v, a = (smooth(x, cutoff)[kept] for x in (q, v, a))
    logged = None if recording.v is None else smooth(recording.v, cutoff)[kept]
    at = {lag: kept + round(lag * rate) for lag in _LAGS}
    later = {lag: tau[np.clip(rows, 0, samples - 1)] for lag, rows in at.items()}
    return State(q, v, a, tau[kept], logged, later)
