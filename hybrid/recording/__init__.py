"""Joint logs: read, write, check and resample them."""

from hybrid.recording.clock import resample, unbroken
from hybrid.recording.read import read, read_all, recording_from_table
from hybrid.recording.recording import Recording
from hybrid.recording.write import write

__all__ = [
    "Recording",
    "read",
    "read_all",
    "recording_from_table",
    "resample",
    "unbroken",
    "write",
]
