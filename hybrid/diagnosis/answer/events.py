"""What happened at a time: contacts of a moving arm, and pushes on one at rest."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Index
from hybrid.diagnosis.gap.gap import Gap
from hybrid.effects import Effect
from hybrid.identification.preparation import STANDING
from hybrid.statistics import robust_std

_AT_REST = 0.01  # rad/s or m/s
_SIGNIFICANT = 8.0  # standard deviations of the holding torque
_LEAST = 0.01  # of the rated torque
_SAME_POSTURE = 0.02  # rad or m, between two samples at rest
_SHORTEST = 0.05  # s, of an event
_PAUSE = 0.2  # s, between two events, and from a stop to one
_LEAST_REST = 1.0  # s at rest, to estimate the holding torque
_EACH = "each recording"


@dataclass(frozen=True)
class Event:
    """A contact of the arm, or a push on it.

    Attributes:
        recording: Source of the log, or its number from 0; ``each recording`` if it is
            at the same time in all of them.
        start: Time of its first sample, by the clock of the diagnosis, [s].
        end: Time of its last sample, [s].
        torque: Mean torque of each joint against it, shape (n,), [N·m].
        force: Force and moment of the last link on what it touches, in the base frame,
            shape (6,), [N, N·m].
    """

    recording: str
    start: float
    end: float
    torque: tuple[float, ...]
    force: tuple[float, ...]


def contacts_in_motion(gap: Gap, effects: Iterable[Effect]) -> tuple[Event, ...]:
    """The contacts among some effects, in order of recording and time."""
    found, t = [], gap.sampled.t
    for effect in (e for e in effects if e.repeats == "recording"):
        number, start = int(effect.values["recording"]), effect.values["start"]
        end = start + effect.values["duration"]
        during = gap.sampled.mask & (t >= start) & (t < end)
        during &= (gap.trajectory == number) | (number < 0)
        own = np.unique(gap.trajectory[during])
        number = int(own[0]) if len(own) == 1 else number
        if during.any():
            push = effect.push(t, gap.trajectory)[during]
            torque = np.einsum("mnk,mk->n", _wrenches(gap)[during], push) / len(push)
            event = _event(gap, number, start, end, torque, push.mean(axis=0))
            found.append((number, start, event))
    return tuple(event for *_, event in sorted(found, key=lambda x: x[:2]))


def _event(
    gap: Gap, number: int, start: float, end: float, torque: Array, force: Array
) -> Event:
    name = gap.motions[number].source or str(number) if number >= 0 else _EACH
    return Event(name, start, end, tuple(torque.tolist()), tuple(force.tolist()))


def _wrenches(gap: Gap) -> Array:
    """Torque per force and moment of the last link, shape (M, n, 6)."""
    last = gap.robot.size - 1
    parts = [sampler(body.wrench_columns(last)) for _, body, sampler in gap]
    return np.concatenate(parts)


def events_at_rest(gap: Gap) -> tuple[Event, ...]:
    """Find pushes while no joint moves, in order of time."""
    # What the simulator lacks differs from posture to posture. Each is compared with
    # the median torque in the same one.
    sampled = gap.sampled
    v = np.abs(sampled.v)
    slow = v <= np.maximum(STANDING * v.max(axis=0, initial=0.0), _AT_REST)
    still = sampled.mask & slow.all(axis=1)
    found, push = list[Event](), _wrenches(gap)
    for r in range(len(gap.motions)):
        rests = np.flatnonzero(still & (gap.trajectory == r))
        away = np.abs(np.diff(sampled.q[rests], axis=0)).max(axis=1, initial=0.0)
        for rows in np.split(rests, np.flatnonzero(away > _SAME_POSTURE) + 1):
            found += _pushes(gap, rows, push)
    return tuple(found)


def _pushes(gap: Gap, rows: Index, push: Array) -> Iterator[Event]:
    """Pushes at some samples of a recording, at rest in one posture."""
    # A drive's torque settles for some time after a stop, which is no push.
    if len(rows) < _LEAST_REST * gap.rate:
        return
    rated = np.array([s.torque for s in gap.scales])
    x = gap.left[rows] - np.median(gap.left[rows], axis=0)
    least = np.maximum(_SIGNIFICANT * robust_std(x), _LEAST * rated)
    at = np.flatnonzero(np.any(np.abs(x) > least, axis=1))
    ends = np.flatnonzero(np.diff(rows[at]) > _PAUSE * gap.rate) + 1
    stops = np.flatnonzero(np.diff(rows, prepend=-2) > 1)
    for own in np.split(at, ends):
        if len(own) < max(_SHORTEST * gap.rate, 2):
            continue
        if own[0] - stops[stops <= own[0]].max() < _PAUSE * gap.rate:
            continue
        torque, t = x[own].mean(axis=0), gap.sampled.t[rows[own]].tolist()
        force = np.linalg.lstsq(push[rows[own]].mean(axis=0), torque, rcond=1e-3)[0]
        yield _event(gap, int(gap.trajectory[rows[0]]), t[0], t[-1], torque, force)
