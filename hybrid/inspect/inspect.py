"""Check whether a log can come from this arm, for every verb.

A log is held against physics: first each sample, then the motion, by a list of checks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from hybrid.inspect.coverage import JointCoverage, coverage_of, excitation_of
from hybrid.inspect.doubt import Doubt, act_on, is_error
from hybrid.inspect.inspection import Inspection, clock_of
from hybrid.inspect.leaps import doubts_of_rows
from hybrid.inspect.physics import doubts_of_magnitude, doubts_of_physics
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.samples import doubts_of_samples
from hybrid.inspect.scale import doubts_of_scale
from hybrid.inspect.speeds import doubts_of_pace, doubts_of_speeds
from hybrid.inspect.state import State, sampled
from hybrid.recording import Recording, resample, unbroken
from hybrid.robot import Robot

# The surest cause first: an error may be why later checks would find one.
OF_SAMPLES = (doubts_of_samples, doubts_of_rows, doubts_of_positions)
OF_MOTION = (
    doubts_of_magnitude,
    doubts_of_physics,
    doubts_of_speeds,
    doubts_of_pace,
    doubts_of_scale,
)


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
    looked = [_examined(piece, robot) for piece in unbroken(recording)]
    doubts = tuple(dict.fromkeys(x for look in looked for x in look.doubts))
    longest = max(looked, key=lambda look: look.recording.duration)
    joints: tuple[JointCoverage, ...] = ()
    excitation = None
    if longest.state is not None:
        joints = coverage_of(longest.recording, longest.state)
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
    doubts: list[Doubt]
    recording: Recording  # on a uniform clock if its samples are right
    state: State | None = None  # if they are


def _checked(recording: Recording, robot: Robot) -> Iterator[Recording]:
    for piece in unbroken(recording.in_order(robot.joints)):
        look = _examined(piece, robot)
        act_on(look.doubts, recording.source)
        yield look.recording


def _examined(recording: Recording, robot: Robot | None) -> _Look:
    """Doubts about a log without gaps."""
    found: list[Doubt] = []
    for of_samples in OF_SAMPLES:
        found += of_samples(recording, robot)
        if any(map(is_error, found)):
            return _Look(found, recording)
    uniform = resample(recording)
    state = sampled(uniform, robot)
    for of_motion in OF_MOTION:
        found += of_motion(uniform, robot, state)
        if any(map(is_error, found)):
            break
    return _Look(found, uniform, state)
