"""Export models to C, ONNX, TorchScript, MJCF, URDF, Isaac Lab and JSON."""

from hybrid.exports.export import FORMATS as FORMATS
from hybrid.exports.export import export as export
from hybrid.exports.manifest import read_manifest as read_manifest
from hybrid.exports.simulator.model import missing_model as missing_model
from hybrid.exports.simulator.model import model_simulator as model_simulator
from hybrid.exports.simulator.posterior import sample as sample
from hybrid.exports.simulator.ranges import ranges as ranges
from hybrid.exports.simulator.simulator import build_simulator as build_simulator
