"""Joint logs: what they hold, where they come from, and whether they can be right."""

from hybrid.recording.check import check_recording
from hybrid.recording.clock import resample, unbroken
from hybrid.recording.read import read, read_all
from hybrid.recording.recording import Recording
from hybrid.recording.write import write

__all__ = [
    "Recording",
    "check_recording",
    "read",
    "read_all",
    "resample",
    "unbroken",
    "write",
]
