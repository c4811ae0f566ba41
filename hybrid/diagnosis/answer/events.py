"""Find pushes on an arm at rest: intervals in which its holding torque changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import median_abs_deviation

from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects.contact import Contact
from hybrid.identification.preparation import STANDING

_AT_REST = 0.01  # rad/s or m/s
_SIGNIFICANT = 8.0  # standard deviations of the holding torque
_LEAST = 0.01  # of the rated torque
_SHORTEST, _PAUSE = 0.05, 0.2  # s, of an event, and between two events
_LEAST_REST = 1.0  # s at rest, to estimate the holding torque


@dataclass(frozen=True)
class Event:
    """A push on an arm that stood still.

    Attributes:
        recording: Source of the log, or its number from 0.
        start: Time of its first sample, by the clock of the diagnosis, [s].
        end: Time of its last sample, [s].
        torque: Mean torque of each joint against it, shape (n,), [N·m].
        force: Least-squares force and moment at the last link, in the base frame,
            shape (6,), [N, N·m].
    """

    recording: str
    start: float
    end: float
    torque: tuple[float, ...]
    force: tuple[float, ...]


def events_at_rest(gap: Gap) -> tuple[Event, ...]:
    """Find pushes while no joint moves, in order of time."""
    sampled, n = gap.sampled, gap.robot.size
    v = np.abs(sampled.v)
    slow = v <= np.maximum(STANDING * v.max(axis=0, initial=0.0), _AT_REST)
    still = sampled.mask & slow.all(axis=1)
    rated = np.array([s.torque for s in gap.scales])
    found = []
    wrench = gap.columns(Contact(tuple(range(n)), {"start": 0.0, "duration": 1e9}))
    push = np.stack([wrench[j] for j in range(n)], axis=1)  # (M, n, 6)
    for r, motion in enumerate(gap.motions):
        rows = np.flatnonzero(still & (gap.trajectory == r))
        if len(rows) < _LEAST_REST * gap.rate:
            continue
        x = gap.left[rows] - np.median(gap.left[rows], axis=0)
        noise = median_abs_deviation(x, scale="normal")
        least = np.maximum(_SIGNIFICANT * noise, _LEAST * rated)
        at = np.flatnonzero(np.any(np.abs(x) > least, axis=1))
        ends = np.flatnonzero(np.diff(rows[at]) > _PAUSE * gap.rate) + 1
        for own in np.split(at, ends):
            if len(own) < max(_SHORTEST * gap.rate, 2):
                continue
            torque, t = x[own].mean(axis=0), sampled.t[rows[own]]
            columns = push[rows[own]].mean(axis=0)
            force = np.linalg.lstsq(columns, torque, rcond=1e-3)[0]
            found.append(
                Event(
                    motion.source or str(r),
                    float(t[0]),
                    float(t[-1]),
                    tuple(torque.tolist()),
                    tuple(force.tolist()),
                )
            )
    return tuple(found)
