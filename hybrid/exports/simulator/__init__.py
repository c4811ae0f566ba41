"""The user's own simulator with what was found: MJCF, URDF, Isaac Lab, and ranges."""

from hybrid.exports.simulator.model import missing_model, model_simulator
from hybrid.exports.simulator.posterior import sample
from hybrid.exports.simulator.ranges import Ranges, ranges
from hybrid.exports.simulator.simulator import Simulator, build_simulator
from hybrid.exports.simulator.snippets import isaac_lab
from hybrid.exports.simulator.write import write_ranges

__all__ = [
    "Ranges",
    "Simulator",
    "isaac_lab",
    "missing_model",
    "model_simulator",
    "ranges",
    "sample",
    "build_simulator",
    "write_ranges",
]
