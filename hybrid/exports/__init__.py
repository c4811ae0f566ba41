"""Models for other programs: C, ONNX, TorchScript, MJCF, URDF, JSON."""

from hybrid.exports.compiled import CompiledModel
from hybrid.exports.export import FORMATS, export
from hybrid.exports.manifest import read_manifest
from hybrid.exports.program import Program, program_from_model
from hybrid.exports.simulator import (
    Ranges,
    Simulator,
    build_simulator,
    missing_model,
    model_simulator,
    ranges,
    sample,
)

__all__ = [
    "FORMATS",
    "CompiledModel",
    "Program",
    "Ranges",
    "Simulator",
    "export",
    "missing_model",
    "model_simulator",
    "program_from_model",
    "ranges",
    "read_manifest",
    "sample",
    "build_simulator",
]
