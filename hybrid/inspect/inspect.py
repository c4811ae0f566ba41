"""Check whether a log can come from this arm, for every verb."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from hybrid.inspect.coverage import (
    Excitation,
    JointCoverage,
    coverage_of,
    excitation_of,
)
from hybrid.inspect.doubt import Doubt, act_on, is_error
from hybrid.inspect.inspection import Inspection, clock_of
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


def inspect_recording(recording: Recording, robot: Robot | None = None) -> Inspection:
    """Inspect a log: its clock, its excitation, and reasons to mistrust it.

    Samples are looked at first, then positions against limits, then order, sign, unit
    and clock against physics. Nothing is asked of physics where a sample is wrong.

    Args:
        recording: Joint log; its columns may be in any order if its joints have the
            robot's names, and are taken in the robot's order if only numbered. A log
            with gaps is looked at piece by piece.
        robot: The arm; without it, physics is not asked.

    Returns:
        Clock, joints and doubts; no doubts if the log is in order.

    Raises:
        RecordingError: Its joints are not the robot's.

    Warns:
        HybridWarning: The log has gaps, or an irregular clock.
    """
    if robot is not None:
        recording = recording.in_order(robot.joints)
    pieces = unbroken(recording)
    looked = [_examined(piece, robot) for piece in pieces]
    doubts = tuple(dict.fromkeys(x for found in looked for x in found.doubts))
    longest = looked[int(np.argmax([piece.duration for piece in pieces]))]
    joints: tuple[JointCoverage, ...] = ()
    excitation: Excitation | None = None
    if longest.state is not None:
        joints = coverage_of(longest.uniform, longest.state)
        if robot is not None and recording.has_torque:
            excitation = excitation_of(robot.chain, longest.state)
    return Inspection(recording, clock_of(recording), joints, excitation, doubts)


def check_recordings(recordings: Sequence[Recording], robot: Robot) -> list[Recording]:
    """Check logs for a verb, and refuse those that would mislead it.

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


@dataclass(frozen=True, eq=False)
class _Look:
    doubts: tuple[Doubt, ...]
    uniform: Recording  # on a uniform clock if its samples are right
    state: State | None = None  # if they are


def _checked(recording: Recording, robot: Robot) -> Iterator[Recording]:
    for piece in unbroken(recording.in_order(robot.joints)):
        look = _examined(piece, robot)
        act_on(look.doubts, recording.source)
        yield look.uniform


def _examined(recording: Recording, robot: Robot | None) -> _Look:
    """Doubts about a log without gaps."""
    found: list[Doubt] = []
    positions = () if robot is None else doubts_of_positions(recording, robot)
    for doubts in (doubts_of_samples(recording), doubts_of_rows(recording), positions):
        found += doubts
        if any(map(is_error, found)):
            return _Look(tuple(found), recording)
    uniform = resample(recording)
    state = sampled(uniform)
    if robot is not None:
        relaxed = np.where(robot.stiffness > 0, robot.springref, np.nan)
        state = replace(state, relaxed=relaxed)
    for doubts in _of_physics(uniform, robot, state):
        found += doubts
        if any(map(is_error, found)):
            break
    return _Look(tuple(found), uniform, state)


def _of_physics(
    recording: Recording, robot: Robot | None, state: State
) -> Iterator[Iterator[Doubt]]:
    """Questions to ask of samples that are right each, the surest cause first."""
    if recording.has_torque and robot is not None:
        yield doubts_of_magnitude(recording, robot.chain, state)
        yield doubts_of_physics(recording, robot.chain, state)
    yield doubts_of_speeds(recording, state)
    if robot is not None:
        yield doubts_of_pace(recording, robot, state)
        if recording.has_torque:
            yield doubts_of_scale(recording, robot, state)
