"""Faulty samples of a recording: frozen, saturated, or beside a jump of torque."""

from dataclasses import dataclass

import numpy as np

from hybrid.arrays import Array, Mask
from hybrid.inspect.samples import stuck_position
from hybrid.inspect.stuck import stuck_torque
from hybrid.recording import Recording

_JUMP = 5.0  # times the usual step
_LEAP = 0.25  # of the range of torque, from one sample to the next
_IMPACT = 3.0  # times a large step of speed
_NEIGHBOUR = 1 / 3  # of a step, the one before or after it
_UNDER_WAY, _BESIDE = 0.05, 3  # of the highest speed; samples to either side


@dataclass(frozen=True, eq=False)
class Faults:
    """Samples of a recording that cannot be used."""

    posture: Mask  # whose position is wrong, for all joints, shape (N,)
    torque: Mask  # whose torque is wrong, shape (N, n)
    notes: tuple[str, ...]  # the same in words


def find_faults(recording: Recording) -> Faults:
    """Find samples where a channel repeats a value while the arm moves, or jumps."""
    q, tau, t = recording.q, recording.tau, recording.t
    notes = []
    posture, torque = np.zeros(len(t), dtype=bool), np.zeros(tau.shape, dtype=bool)
    for j, name in enumerate(recording.joints):
        frozen = stuck_position(t, q[:, j])
        if frozen.any():
            posture |= frozen
            notes.append(f"position of {name} is frozen for {frozen.mean():.0%}")
        stuck = stuck_torque(t, q, tau[:, j])
        for bad, word in zip(stuck, ("frozen", "saturated"), strict=True):
            if bad.any():
                torque[:, j] |= bad
                notes.append(f"torque of {name} is {word} for {bad.mean():.0%}")
    leaps = _leaps(t, q, tau)
    if leaps.any():
        at = leaps.any(axis=1)
        posture |= at
        where = [recording.joints[j] for j in np.flatnonzero(leaps.any(axis=0))]
        notes.append(
            f"torque of {', '.join(where)} jumps while the joint moves, first at "
            f"{t[at][0]:.3g} s, faster than the samples resolve: samples near it are "
            "left out"
        )
    place = f"{recording.source}: " if recording.source else ""
    return Faults(posture, torque, tuple(place + note for note in notes))


def _leaps(t: Array, q: Array, tau: Array) -> Mask:
    """Samples beside a rare jump of torque while a joint moves, shape (N, n)."""
    # Where the reference jumps, so does the acceleration, at a time between two samples
    # that derivatives of positions do not resolve.
    steps, v = np.diff(tau, axis=0), np.diff(q, axis=0) / np.diff(t)[:, None]
    around = np.stack([np.roll(v, k, axis=0) for k in (-_BESIDE, 0, _BESIDE)])
    slowest = _UNDER_WAY * np.abs(v).max(axis=0, initial=0.0)
    # At a reversal dry friction jumps as well: these are no faults.
    under_way = np.all(around > slowest, axis=0) | np.all(around < -slowest, axis=0)
    size = np.abs(steps)
    # A fast change of torque takes several steps in one direction.
    same = [np.roll(steps, k, axis=0) * np.sign(steps) for k in (-1, 1)]
    alone = np.maximum(*same) < _NEIGHBOUR * size
    # At an impact, as when backlash closes, the speed jumps as well.
    changes = np.abs(np.diff(v, axis=0, append=v[-1:]))
    impact = np.max([np.roll(changes, k, axis=0) for k in (-1, 0, 1)], axis=0)
    impact = impact > _IMPACT * np.quantile(changes, 0.99, axis=0)
    usual = np.quantile(size, 0.99, axis=0)
    far = size > np.maximum(_JUMP * usual, _LEAP * np.ptp(tau, axis=0))
    leap = under_way & alone & far & ~impact
    edge = np.zeros((1, leap.shape[1]), dtype=bool)
    return np.asarray(np.vstack([leap, edge]) | np.vstack([edge, leap]))
