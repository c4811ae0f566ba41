"""Rows that do not follow from those before: glitches, jumps, held and repeated rows.

An arm has mass: between two samples its position changes hardly otherwise than between
the two before. What is out and back within a sample, or elsewhere from one to the next,
is of the log.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hybrid.inspect.doubt import Doubt
from hybrid.inspect.samples import STILL, usual_step
from hybrid.recording import Recording
from hybrid.recording.recording import row_words

Array = NDArray[np.float64]

_LEAP = 10.0  # times a large step of the joint, and times any step nearby
_TICKS = 10.0  # steps of an encoder: fewer are its noise
_NEARBY = 5  # samples to either side
_ALIKE = 0.2  # relative difference of the way out and the way back
_HELD, _SURE = 3, 0.9  # rows; share of new rows that come so far apart
_REPEATED = 50  # rows


def doubts_of_rows(recording: Recording) -> Iterator[Doubt]:
    """Rows that no moving arm can have made.

    Args:
        recording: The log.
    """
    yield from _repeated(recording)
    yield from _held(recording)
    for joint, x in enumerate(recording.q.T):
        yield from _leaping(recording, joint, x)


def _leaping(recording: Recording, joint: int, x: Array) -> Iterator[Doubt]:
    """Glitches and jumps of one position."""
    steps = np.diff(x)
    size = np.abs(steps)
    around = np.zeros_like(size)
    for k in range(2, _NEARBY + 1):
        around[k:] = np.maximum(around[k:], size[:-k])
        around[:-k] = np.maximum(around[:-k], size[k:])
    tick = float(np.min(size[size > 0], initial=np.inf))
    far = max(_TICKS * tick, 2 * usual_step(x))
    leaps = (size > _LEAP * around) & (size > far)
    back = np.append(np.abs(steps[1:] + steps[:-1]) < _ALIKE * size[:-1], False)
    glitches = np.flatnonzero(leaps & back & np.append(leaps[1:], False))
    before, after = np.append(0.0, size[:-1]), np.append(size[1:], 0.0)
    alone = leaps & (size > _LEAP * np.maximum(before, after))
    # From standstill on the way: an encoder was frozen, which is told apart.
    alone &= (_around(before, -1) > 0) == (_around(after, 1) > 0)
    remedy = "valid are positions as the joint passed them"
    if len(glitches):
        row = int(glitches[0]) + 1
        text = (
            f"{recording.place('q', joint, row)}: glitch: {x[row]:.6g} between "
            f"{x[row - 1]:.6g} and {x[row + 1]:.6g}, the first of {len(glitches)}"
        )
        advice = f"{remedy}: leave such rows out"
        yield Doubt("q", (joint,), text, advice, "error", len(glitches))
    for k in np.flatnonzero(alone)[:1].tolist():
        turn = abs(abs(float(steps[k])) - 2 * np.pi) < 0.1
        what = "a turn of the encoder is not counted" if turn else "logs put together?"
        text = (
            f"{recording.place('q', joint, k + 1)}: jumps from {x[k]:.6g} to "
            f"{x[k + 1]:.6g} within a sample: {what}"
        )
        yield Doubt("q", (joint,), text, remedy, "error", float(size[k]))


def _around(size: Array, way: int) -> Array:
    """Largest of a few steps before, or after, each, shape (N,)."""
    moved = [np.roll(size, -way * k) for k in range(_NEARBY)]
    return np.asarray(np.max(moved, axis=0))


def _held(recording: Recording) -> Iterator[Doubt]:
    """Rows that are written several times each."""
    parts = [recording.q]
    if recording.has_torque:
        parts.append(recording.tau)
    for name, rows in (("every channel", np.hstack(parts)), ("q", recording.q)):
        fresh = np.flatnonzero(np.any(np.diff(rows, axis=0) != 0, axis=1))
        apart = np.diff(fresh)
        if len(apart) < _REPEATED:
            continue
        step = int(np.median(apart))
        if step >= _HELD and float(np.mean(apart % step == 0)) > _SURE:
            text = f"{name} holds each sample for {step} rows"
            remedy = f"valid is one row for each sample: keep every {step}th"
            yield Doubt("q", (), text, remedy, "error", step)
            return


def _repeated(recording: Recording) -> Iterator[Doubt]:
    """The log once more within itself."""
    rows = np.hstack([recording.q, recording.tau])
    start = int(np.argmax(np.abs(recording.q - recording.q[0]).max(axis=1) > STILL))
    again = np.flatnonzero((rows[start + 1 :] == rows[start]).all(axis=1)) + start + 1
    for k in again.tolist():
        count = min(_REPEATED, len(rows) - k)
        same = np.array_equal(rows[k : k + count], rows[start : start + count])
        moves = np.ptp(rows[k : k + count, : recording.size], axis=0).max() > STILL
        if count == _REPEATED and same and moves:
            text = f"from {row_words(k - start)} on the log repeats its first rows"
            remedy = "valid is each motion once: split the log there"
            yield Doubt("q", (), text, remedy, "error", k - start)
            return
