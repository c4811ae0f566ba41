"""The identified model of drive torque, and its file."""

from hybrid.model.dynamic_model import DynamicModel, check_same_arm

__all__ = ["DynamicModel", "check_same_arm"]
