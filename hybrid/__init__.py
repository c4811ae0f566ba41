"""Identify a robot arm's drive torque and diagnose its sim-to-real gap.

The torque that a joint drive reports is a sum of terms: rigid body + effects + a
learned remainder. What is named here loads on first use: ``import hybrid`` is fast.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybrid.calibration import calibrate
    from hybrid.diagnosis.answer.diagnosis import Diagnosis
    from hybrid.diagnosis.diagnose import diagnose
    from hybrid.effects import Effect, effect_classes
    from hybrid.excitation import design as excite
    from hybrid.exports.export import export
    from hybrid.fleets.fleet import Fleet, fleet
    from hybrid.identification import DynamicModel, Fit, identify, predict, validate
    from hybrid.identification.identifier import Identifier
    from hybrid.inspect import Inspection, inspect_recording
    from hybrid.online import OnlineIdentifier, Sample
    from hybrid.plant import simulate
    from hybrid.recording import Recording, recording_from_table
    from hybrid.recording import read_all as read_recordings
    from hybrid.robot import Robot
    from hybrid.servo import ServoFit, fit_servo
    from hybrid.signals import Motion

__version__ = "0.1.0"

__all__ = [
    "Diagnosis",
    "DynamicModel",
    "Effect",
    "Fit",
    "Fleet",
    "Identifier",
    "Inspection",
    "Motion",
    "OnlineIdentifier",
    "Recording",
    "Robot",
    "Sample",
    "ServoFit",
    "__version__",
    "calibrate",
    "diagnose",
    "effect_classes",
    "excite",
    "export",
    "fit_servo",
    "fleet",
    "identify",
    "inspect_recording",
    "predict",
    "read_recordings",
    "recording_from_table",
    "simulate",
    "validate",
]

# Public name -> the module it lives in, and its name there where that is another one.
_HOME = {
    "Diagnosis": "hybrid.diagnosis.answer.diagnosis",
    "DynamicModel": "hybrid.identification",
    "Effect": "hybrid.effects",
    "Fleet": "hybrid.fleets",
    "Fit": "hybrid.identification",
    "Identifier": "hybrid.identification.identifier",
    "Inspection": "hybrid.inspect",
    "Motion": "hybrid.signals",
    "OnlineIdentifier": "hybrid.online",
    "Recording": "hybrid.recording",
    "Robot": "hybrid.robot",
    "Sample": "hybrid.online",
    "ServoFit": "hybrid.servo",
    "calibrate": "hybrid.calibration",
    "diagnose": "hybrid.diagnosis.diagnose",
    "effect_classes": "hybrid.effects",
    "excite": "hybrid.excitation:design",
    "export": "hybrid.exports",
    "fit_servo": "hybrid.servo",
    "fleet": "hybrid.fleets",
    "identify": "hybrid.identification",
    "inspect_recording": "hybrid.inspect",
    "predict": "hybrid.identification",
    "read_recordings": "hybrid.recording:read_all",
    "recording_from_table": "hybrid.recording",
    "simulate": "hybrid.plant",
    "validate": "hybrid.identification",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}")
    module, _, original = _HOME[name].partition(":")
    value = getattr(import_module(module), original or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
