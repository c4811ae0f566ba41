"""The user's own simulator with what was found: MJCF, URDF, Isaac Lab, and ranges."""

from hybrid.export.simulator.model import missing_model, model_simulator
from hybrid.export.simulator.simulator import Simulator, simulator

__all__ = ["Simulator", "missing_model", "model_simulator", "simulator"]
