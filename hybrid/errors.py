"""Errors that a user can act on: each says what is wrong and what is valid."""

import sys
import warnings
from types import FrameType

_PACKAGE = __name__.partition(".")[0]


class HybridError(Exception):
    """Base of every error raised on purpose; its message is one readable line."""


class RobotError(HybridError):
    """A robot file cannot be read or is not a serial arm."""


class RecordingError(HybridError):
    """A recording cannot be read, or does not hold what its columns say."""


class EffectError(HybridError):
    """An effect is unknown, misplaced, or has a parameter out of bounds."""


class ExcitationError(HybridError):
    """A motion that was asked for cannot be had within the limits."""


class IdentificationError(HybridError):
    """The data cannot support the fit that was asked for."""


class CalibrationError(HybridError):
    """Measured poses cannot be read, or cannot support the calibration asked for."""


class ModelFileError(HybridError):
    """A saved model is damaged, of another version, or of another robot."""


class HybridWarning(UserWarning):
    """Something a user should know that does not stop the work."""


def warn(text: str) -> None:
    """Warn by a :class:`HybridWarning`, at the line outside the package that asked."""
    frame: FrameType | None = sys._getframe(1)
    level = 2
    while frame and frame.f_globals.get("__name__", "").partition(".")[0] == _PACKAGE:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, HybridWarning, stacklevel=level)
