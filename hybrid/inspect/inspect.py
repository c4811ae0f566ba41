"""One question for every verb: can this log be what its columns say, of this arm?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from hybrid.inspect.doubt import Doubt, act_on, is_error
from hybrid.inspect.leaps import doubts_of_rows
from hybrid.inspect.magnitude import doubts_of_magnitude
from hybrid.inspect.physics import doubts_of_physics
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.samples import doubts_of_samples
from hybrid.inspect.scale import doubts_of_scale
from hybrid.inspect.speeds import doubts_of_pace, doubts_of_speeds
from hybrid.inspect.state import State, sampled
from hybrid.recording import Recording, resample, unbroken
from hybrid.robot import Robot


def inspect_recording(recording: Recording, robot: Robot) -> tuple[Doubt, ...]:
    """What speaks against a log being what its columns say.

    Samples are looked at first, then positions against limits, then order, sign, unit
    and clock against physics. Nothing is asked of physics where a sample is wrong.

    Args:
        recording: Joint log without gaps; its columns may be in any order if its joints
            have the robot's names, and are taken in the robot's order if only numbered.
        robot: The arm.

    Returns:
        Doubts, none if the log is in order; of several errors the first is the
        likeliest to be the cause of others.

    Raises:
        RecordingError: Its joints are not the robot's.
    """
    return _examined(recording.in_order(robot.joints), robot)[0]


def check_recordings(recordings: Sequence[Recording], robot: Robot) -> list[Recording]:
    """Logs as every verb takes them, or the reason why one cannot be taken.

    Args:
        recordings: Joint logs.
        robot: The arm.

    Returns:
        Logs with the robot's joints in its order, on uniform clocks; one with gaps of
        more than ten steps is several.

    Raises:
        RecordingError: A log is wrong: it says what, where, and what is valid.

    Warns:
        HybridWarning: Something may be wrong; a log has gaps, or an irregular clock.
    """
    return list(chain.from_iterable(_checked(x, robot) for x in recordings))


def _checked(recording: Recording, robot: Robot) -> Iterator[Recording]:
    for piece in unbroken(recording.in_order(robot.joints)):
        doubts, uniform = _examined(piece, robot)
        act_on(doubts, recording.source)
        yield uniform


def _examined(
    recording: Recording, robot: Robot
) -> tuple[tuple[Doubt, ...], Recording]:
    """Doubts about a log, and the log on a uniform clock if its samples are right."""
    found: list[Doubt] = []
    for doubts in (
        doubts_of_samples(recording),
        doubts_of_rows(recording),
        doubts_of_positions(recording, robot),
    ):
        found += doubts
        if any(map(is_error, found)):
            return tuple(found), recording
    uniform = resample(recording)
    relaxed = np.where(robot.stiffness > 0, robot.springref, np.nan)
    state = replace(sampled(uniform), relaxed=relaxed)
    for doubts in _of_physics(uniform, robot, state):
        found += doubts
        if any(map(is_error, found)):
            break
    return tuple(found), uniform


def _of_physics(
    recording: Recording, robot: Robot, state: State
) -> Iterator[Iterator[Doubt]]:
    """Questions to ask of samples that are right each, the surest cause first."""
    if recording.has_torque:
        yield doubts_of_magnitude(recording, robot.chain, state)
        yield doubts_of_physics(recording, robot.chain, state)
    yield doubts_of_speeds(recording, state)
    yield doubts_of_pace(recording, robot, state)
    if recording.has_torque:
        yield doubts_of_scale(recording, robot, state)
