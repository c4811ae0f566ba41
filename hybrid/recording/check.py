"""Can this recording be what its columns say, on this robot?"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hybrid.errors import HybridWarning, RecordingError
from hybrid.recording.clock import resample
from hybrid.recording.recording import Recording, row_words
from hybrid.recording.units import check_positions

if TYPE_CHECKING:
    from hybrid.robot import Robot

Array = NDArray[np.float64]

SHORTEST = 1.0  # s: below, not even one slow move
FEWEST = 100  # samples
STILL = 1e-3  # rad: less travel is hum, not motion
FARTHEST_TORQUE = 5.0  # times the rating: gear or unit missing, not overload
_COARSEST = 0.01  # rad: no joint encoder resolves less


def check_recording(recording: Recording, robot: Robot) -> Recording:
    """Hold a recording against the robot it is said to be from.

    Args:
        recording: Joint log; its columns may be in any order if its joints have the
            robot's names, and are taken in the robot's order if only numbered.
        robot: The arm.

    Returns:
        The recording with the robot's joints in the robot's order, on a uniform clock.

    Raises:
        RecordingError: Joints do not match or are in another order; positions look
            like degrees; nothing moves; a measured torque is constant; the log is too
            short or has a long gap.

    Warns:
        HybridWarning: Positions are outside the limits, torques far above the rating;
            a channel is constant, frozen for a while or saturated; the clock is
            irregular.
    """
    recording = recording.in_order(robot.joints)
    _check_length(recording)
    check_positions(recording, robot)
    _check_motion(recording)
    if recording.has_torque:
        _check_torque(recording, robot)
    _check_frozen(recording)
    return resample(recording)


def longest_run(x: Array) -> tuple[int, int]:
    """Length and first index of the longest run of equal values of ``x``, (N,)."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(x)) + 1, [len(x)]])
    lengths = np.diff(starts)
    return int(lengths.max()), int(starts[np.argmax(lengths)])


def usual_step(x: Array) -> float:
    """Size of a large step of a position, shape (N,), between two samples.

    Of a joint at rest, which mostly makes none, that of its encoder.
    """
    steps = np.abs(np.diff(x))
    tick = np.min(steps[steps > 0], initial=_COARSEST)
    return max(float(np.quantile(steps, 0.99)), float(tick))


def _check_length(recording: Recording) -> None:
    if recording.duration < SHORTEST or len(recording.t) < FEWEST:
        raise RecordingError(
            f"{recording.source}: too short: {len(recording.t)} samples in "
            f"{recording.duration:.3g} s; valid are {FEWEST} samples and "
            f"{SHORTEST:g} s or more"
        )


def _check_motion(recording: Recording) -> None:
    travel = np.ptp(recording.q, axis=0)
    if np.all(travel < STILL):
        raise RecordingError(
            f"{recording.source}: q: no joint moves more than {travel.max():.2g} rad; "
            f"valid is a log in which the arm moves by {STILL:g} rad or more"
        )
    for joint in _indices(travel == 0):
        _warn(recording, f"{recording.place('q', joint)} is constant")
    for channel in ("v", "command"):
        x = recording.channels.get(channel)
        if x is None:
            continue
        for joint in _indices((np.ptp(x, axis=0) == 0) & (travel > STILL)):
            where = recording.place(channel, joint)
            _warn(recording, f"{where} is constant while the joint moves")


def _check_torque(recording: Recording, robot: Robot) -> None:
    tau = recording.tau
    for joint in _indices(np.ptp(tau, axis=0) == 0):
        raise RecordingError(
            f"{recording.source}: {recording.place('tau', joint)} is constant "
            f"({tau[0, joint]:g}); valid is a torque that was measured"
        )
    peak = np.max(np.abs(tau), axis=0)
    rated = np.where(robot.tau_max > 0, robot.tau_max, np.inf)
    far = _indices(peak > FARTHEST_TORQUE * rated)
    if far:
        places = ", ".join(
            f"{recording.place('tau', k)} {peak[k]:.4g} of {rated[k]:.4g}" for k in far
        )
        _warn(
            recording,
            f"torque above {FARTHEST_TORQUE:g} times the rating ({places}): in "
            "milliamps? or is the rating that of the motor side? valid are N·m at the "
            "joint",
        )
    for joint, x in enumerate(tau.T):
        for limit in (float(x.min()), float(x.max())):
            share = float(np.mean(x == limit))
            # A peak that is visited is a sample or two; one that is cut off is flat.
            if 0.01 < share and longest_run(np.where(x == limit, 0.0, x))[0] >= 3:
                where = recording.place("tau", joint)
                _warn(
                    recording,
                    f"{where} stays at {limit:.6g} for {share:.1%}: saturated?",
                )


def _check_frozen(recording: Recording) -> None:
    samples = len(recording.t)
    both = np.hstack([recording.q, recording.tau])
    moved = np.any(np.diff(both, axis=0) != 0, axis=1)  # NaN differs from itself
    length, row = longest_run(np.concatenate([[0], np.cumsum(moved)]))
    if length > 10:
        _warn(
            recording,
            f"all channels repeat for {length} samples from "
            f"{row_words(row)}: did the log stop?",
        )
    for joint, x in enumerate(recording.tau.T):
        length, row = longest_run(x)
        if length > max(50, 0.1 * samples):
            where = recording.place("tau", joint, row)
            _warn(recording, f"{where}: frozen for {length} samples")
    for joint, x in enumerate(recording.q.T):
        length, row = longest_run(x)
        # An arm at rest repeats its position too, but it does not jump out of it.
        steps = np.abs(np.diff(x))
        ends = [k for k in (row - 1, row + length - 1) if 0 <= k < len(steps)]
        jump = max((float(steps[k]) for k in ends), default=0.0)
        if length > 20 and jump > 5 * usual_step(x):
            where = recording.place("q", joint, row)
            _warn(recording, f"{where}: frozen for {length} samples, then it jumps")


def _indices(condition: NDArray[np.bool_]) -> list[int]:
    return [int(k) for k in np.flatnonzero(condition)]


def _warn(recording: Recording, text: str) -> None:
    message = f"{recording.source}: {text}"
    warnings.warn(message, HybridWarning, stacklevel=4)
