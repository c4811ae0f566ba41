"""Identify a robot arm's drive torque and diagnose its sim-to-real gap.

The torque that a joint drive reports is a sum of terms: rigid body + effects + a
learned remainder. What is named here loads on first use: ``import hybrid`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hybrid.calibration import calibrate as calibrate
    from hybrid.diagnosis.answer.diagnosis import Diagnosis as Diagnosis
    from hybrid.diagnosis.diagnose import diagnose as diagnose
    from hybrid.effects import Effect as Effect
    from hybrid.effects import effect_classes as effect_classes
    from hybrid.excitation import design
    from hybrid.exports.export import export as export
    from hybrid.fleets.fleet import Fleet as Fleet
    from hybrid.fleets.fleet import fleet as fleet
    from hybrid.identification import DynamicModel as DynamicModel
    from hybrid.identification import Fit as Fit
    from hybrid.identification import identify as identify
    from hybrid.identification import predict as predict
    from hybrid.identification import validate as validate
    from hybrid.identification.identifier import Identifier as Identifier
    from hybrid.inspect import Inspection as Inspection
    from hybrid.inspect import inspect_recording as inspect_recording
    from hybrid.online import OnlineIdentifier as OnlineIdentifier
    from hybrid.online import Sample as Sample
    from hybrid.plant import simulate as simulate
    from hybrid.recording import Recording as Recording
    from hybrid.recording import read_all
    from hybrid.recording import recording_from_table as recording_from_table
    from hybrid.robot import Robot as Robot
    from hybrid.servo import ServoFit as ServoFit
    from hybrid.servo import fit_servo as fit_servo
    from hybrid.signals import Motion as Motion

    excite, read_recordings = design, read_all

__version__ = "0.1.0"

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

__all__ = ["__version__", *_HOME]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'hybrid' has no attribute {name!r}")
    module, _, original = _HOME[name].partition(":")
    value = getattr(import_module(module), original or name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
