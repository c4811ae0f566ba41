"""What identification gives: a model of drive torque, and the file that holds it."""

from hybrid.model.dynamic_model import DynamicModel, check_same_arm

__all__ = ["DynamicModel", "check_same_arm"]
