"""Check a log against physics: first its samples, then its motion and torque."""

from collections.abc import Sequence

from hybrid.arguments import typed
from hybrid.inspect.coverage import (
    JointCoverage,
    coverage_of,
    doubts_of_lags,
    excitation_of,
)
from hybrid.inspect.doubt import Doubt, raise_or_warn
from hybrid.inspect.glitches import doubts_of_rows
from hybrid.inspect.inspection import Inspection, clock_of
from hybrid.inspect.physics import (
    doubts_of_filter,
    doubts_of_magnitude,
    doubts_of_physics,
)
from hybrid.inspect.positions import doubts_of_positions
from hybrid.inspect.samples import doubts_of_samples
from hybrid.inspect.scale import doubts_of_scale
from hybrid.inspect.speeds import doubts_of_speed_limits, doubts_of_speeds
from hybrid.inspect.state import State, filtered_state
from hybrid.recording import Recording, resample, unbroken
from hybrid.robot import Robot

# The most reliable check first: the error that it finds may mislead later checks.
_SAMPLE_CHECKS = (doubts_of_samples, doubts_of_rows, doubts_of_positions)
_MOTION_CHECKS = (
    doubts_of_magnitude,
    doubts_of_physics,
    doubts_of_speeds,
    doubts_of_speed_limits,
    doubts_of_scale,
)


@typed
def inspect_recording(recording: Recording, robot: Robot | None = None) -> Inspection:
    """Inspect a log: its clock, its excitation, and reasons to mistrust it.

    Samples are checked first, then positions against limits, then order, sign, unit and
    clock against rigid-body dynamics. An error ends the checks.

    Args:
        recording: Joint log; its columns may be in any order if its joints have the
            robot's names, and are taken in the robot's order if only numbered. A log
            with gaps is checked piece by piece.
        robot: The arm; without it, dynamics is not checked.

    Returns:
        Clock, joints and doubts; no doubts if the log is in order.

    Raises:
        RecordingError: Its joints are not the robot's.

    Warns:
        HybridWarning: The log has gaps, or an irregular clock.
    """
    if robot is not None:
        recording = recording.in_order(robot.joints)
    pieces = [_checked(piece, robot) for piece in unbroken(recording)]
    doubts = tuple(dict.fromkeys(doubt for found, *_ in pieces for doubt in found))
    _, longest, state = max(pieces, key=lambda piece: piece[1].duration)
    joints: tuple[JointCoverage, ...] = ()
    excitation = None
    if state is not None:
        joints = coverage_of(longest, state, robot.chain if robot else None)
        if robot is not None and recording.has_torque:
            excitation = excitation_of(robot.chain, state)
            doubts += tuple(doubts_of_filter(longest, robot))
    doubts += tuple(doubts_of_lags(joints))
    return Inspection(recording, clock_of(recording), joints, excitation, doubts)


def check_recordings(recordings: Sequence[Recording], robot: Robot) -> list[Recording]:
    """Check logs, and refuse those that lead to a wrong model.

    Args:
        recordings: Joint logs.
        robot: The arm.

    Returns:
        Logs with the robot's joints in its order, on uniform clocks; a log with gaps of
        more than ten steps becomes several.

    Raises:
        RecordingError: A log is wrong: it says what, where, and what is valid.

    Warns:
        HybridWarning: Something may be wrong; a log has gaps, or an irregular clock.
    """
    uniform = []
    for recording in recordings:
        for piece in unbroken(recording.in_order(robot.joints)):
            doubts, checked, _ = _checked(piece, robot)
            raise_or_warn(doubts, recording.source)
            uniform.append(checked)
    return uniform


def _checked(
    recording: Recording, robot: Robot | None
) -> tuple[list[Doubt], Recording, State | None]:
    """Doubts about a log without gaps, it on a uniform clock, and its filtered state.

    If samples are wrong, it is the log as it is, and there is no state.
    """
    doubts: list[Doubt] = []
    for check_samples in _SAMPLE_CHECKS:
        doubts += check_samples(recording, robot)
        if any(doubt.is_error for doubt in doubts):
            return doubts, recording, None
    uniform = resample(recording)
    state = filtered_state(uniform)
    for check_motion in _MOTION_CHECKS:
        doubts += check_motion(uniform, robot, state)
        if any(doubt.is_error for doubt in doubts):
            break
    return doubts, uniform, state
