"""Whether a log can be what its columns say, of the arm it is said to be of."""

from hybrid.inspect.doubt import Doubt
from hybrid.inspect.inspect import check_recordings, inspect_recording
from hybrid.inspect.inspection import Inspection

__all__ = ["Doubt", "Inspection", "check_recordings", "inspect_recording"]
