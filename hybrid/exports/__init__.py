"""Export models to C, ONNX, TorchScript, MJCF, URDF, Isaac Lab and JSON."""

from hybrid.exports.export import FORMATS, export
from hybrid.exports.manifest import read_manifest
from hybrid.exports.simulator.model import missing_model, model_simulator
from hybrid.exports.simulator.posterior import sample
from hybrid.exports.simulator.ranges import ranges
from hybrid.exports.simulator.simulator import build_simulator
from hybrid.model.program import program_from_model

__all__ = [
    "FORMATS",
    "build_simulator",
    "export",
    "missing_model",
    "model_simulator",
    "program_from_model",
    "ranges",
    "read_manifest",
    "sample",
]
