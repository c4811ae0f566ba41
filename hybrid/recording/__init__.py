"""Joint logs: read, write, check and resample them."""

from hybrid.recording.clock import resample as resample
from hybrid.recording.clock import unbroken as unbroken
from hybrid.recording.read import read as read
from hybrid.recording.read import read_all as read_all
from hybrid.recording.read import recording_from_table as recording_from_table
from hybrid.recording.recording import Recording as Recording
from hybrid.recording.write import write as write
