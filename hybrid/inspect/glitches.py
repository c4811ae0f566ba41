"""Find glitches, jumps, held rows and repeated rows.

An arm has mass: its step from sample to sample changes little. A position that leaves
and returns within a sample, or jumps, is a fault of the log. So is a torque that jumps
to what no drive gives.
"""

from collections.abc import Iterator

import numpy as np

from hybrid.arrays import Array
from hybrid.inspect.doubt import Doubt
from hybrid.inspect.samples import STILL, large_step, resolution
from hybrid.recording import Recording
from hybrid.recording.recording import row_words
from hybrid.robot import Robot

_LEAP = 10.0  # times a large step of the joint, and times any step nearby
_ENCODER_NOISE = 10.0  # steps of the encoder
_NEARBY = 5  # samples on either side
_SHAPE_ERROR = 0.2  # relative difference of second differences from 1, −2, 1
_TURN_ERROR = 0.1  # rad, from a whole turn
OVERLOAD = 5.0  # times the rating: more than a drive gives
_RARE = 0.05  # of all samples: where more are above it, the unit or the file is wrong
_HELD_ROWS, _HELD_SHARE = 3, 0.9  # least rows a value is held; share of new values
_REPEATED = 50  # rows


def doubts_of_rows(recording: Recording, robot: Robot | None = None) -> Iterator[Doubt]:
    """Find rows that no moving arm produces."""
    yield from _repeated(recording)
    yield from _held(recording)
    for joint, x in enumerate(recording.q.T):
        yield from _glitches(recording, joint, x)
        yield from _jumps(recording, joint, x)
    if robot is not None and recording.has_torque:
        yield from _bursts(recording, robot)


def _glitches(recording: Recording, joint: int, x: Array) -> Iterator[Doubt]:
    """Find single wrong positions: second differences in the ratio 1, −2, 1.

    A bend is twice the distance of a position from the line between its neighbours, of
    which each has a weight; on a regular clock it is the second difference.
    """
    dt = np.diff(recording.t)
    before = dt[1:] / (dt[1:] + dt[:-1])  # weight of the neighbour before
    bend = 2 * (before * x[:-2] + (1 - before) * x[2:] - x[1:-1])
    size = np.abs(bend)
    shape = [
        np.abs(np.roll(bend, -k) + bend * np.roll(weight, -k)) < _SHAPE_ERROR * size
        for k, weight in ((1, before), (-1, 1 - before))
    ]
    nearby = np.maximum(*_largest_beside(size, 3))
    usual = _LEAP * float(np.quantile(size, 0.75))
    least = max(_ENCODER_NOISE * resolution(x), usual, 2 * STILL)
    found = shape[0] & shape[1] & (size > _LEAP * nearby) & (size > least)
    for row in (np.flatnonzero(found)[:1] + 1).tolist():
        text = (
            f"{recording.place('q', joint, row)}: glitch: {x[row]:.6g} between "
            f"{x[row - 1]:.6g} and {x[row + 1]:.6g}, the first of {found.sum()}"
        )
        remedy = "valid are positions as the joint passed them: leave such rows out"
        yield Doubt("q", (joint,), text, remedy, "error", int(found.sum()), rows=True)


def _jumps(recording: Recording, joint: int, x: Array) -> Iterator[Doubt]:
    """Find steps of a position that are too large for a moving joint."""
    dt = np.diff(recording.t)
    # Where rows are lost, a joint has more time for its step.
    size = np.abs(np.diff(x)) * np.minimum(np.median(dt) / dt, 1.0)
    before, after = _largest_beside(size, 1)
    least = max(_ENCODER_NOISE * resolution(x), 2 * large_step(x))
    found = (size > _LEAP * np.maximum(before, after)) & (size > least)
    # Rest on one side of the jump only: a frozen encoder, which has its own check.
    found &= (before > 0) == (after > 0)
    for k in np.flatnonzero(found)[:1].tolist():
        step = abs(float(x[k + 1] - x[k]))
        turn = abs(step - 2 * np.pi) < _TURN_ERROR
        what = "a turn of the encoder is not counted" if turn else "logs put together?"
        text = (
            f"{recording.place('q', joint, k + 1)}: jumps from {x[k]:.6g} to "
            f"{x[k + 1]:.6g} within a sample: {what}"
        )
        remedy = "valid are positions as the joint passed them"
        yield Doubt("q", (joint,), text, remedy, "error", step, rows=True)


def _bursts(recording: Recording, robot: Robot) -> Iterator[Doubt]:
    """Find torques that jump far above the rating of their drive."""
    for joint, (x, rated) in enumerate(
        zip(recording.tau.T, robot.tau_max, strict=True)
    ):
        step = np.abs(np.diff(x, prepend=x[0]))
        over = np.abs(x) > OVERLOAD * rated
        leaps = np.flatnonzero(over & (step > _LEAP * np.quantile(step, 0.99)))
        if leaps.size and over.mean() < _RARE:
            row, count = int(leaps[0]), int(over.sum())
            text = (
                f"{recording.place('tau', joint, row)}: jumps to {x[row]:.6g}, the "
                f"first of {count} above {OVERLOAD:g} times the drive's {rated:g}"
            )
            remedy = "valid are torques that a drive gives: leave such rows out"
            yield Doubt("tau", (joint,), text, remedy, "error", count, rows=True)


def _largest_beside(size: Array, first: int) -> tuple[Array, Array]:
    """Largest value before and after each sample, from some distance on, (N,) each."""
    lags = range(first, _NEARBY + 1)
    before, after = (
        np.max([np.roll(size, way * k) for k in lags], axis=0) for way in (1, -1)
    )
    return before, after


def _held(recording: Recording) -> Iterator[Doubt]:
    """Find values that are written to several rows each."""
    q, every = recording.q, recording.q
    if recording.has_torque:
        every = np.hstack([q, recording.tau])
    for name, rows in (("every channel", every), ("q", q)):
        fresh = np.flatnonzero(np.any(np.diff(rows, axis=0) != 0, axis=1))
        apart = np.diff(fresh)
        if len(apart) < _REPEATED:
            continue
        step = int(np.median(apart))
        if step >= _HELD_ROWS and float(np.mean(apart % step == 0)) > _HELD_SHARE:
            text = f"{name} holds each sample for {step} rows"
            remedy = f"valid is one row for each sample: keep every {step}th"
            yield Doubt("q", (), text, remedy, "error", step, rows=True)
            return


def _repeated(recording: Recording) -> Iterator[Doubt]:
    """Find a second copy of the log within itself."""
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
            yield Doubt("q", (), text, remedy, "error", k - start, rows=True)
            return
