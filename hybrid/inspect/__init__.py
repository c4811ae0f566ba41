"""Check logs against physics: order, signs, units and clock of their columns."""

from hybrid.inspect.inspect import check_recordings as check_recordings
from hybrid.inspect.inspect import inspect_recording as inspect_recording
from hybrid.inspect.inspection import Inspection as Inspection
