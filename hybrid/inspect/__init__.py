"""Check logs against physics: order, signs, units and clock of their columns."""

from hybrid.inspect.doubt import Doubt
from hybrid.inspect.inspect import check_recordings, inspect_recording
from hybrid.inspect.inspection import Inspection

__all__ = ["Doubt", "Inspection", "check_recordings", "inspect_recording"]
