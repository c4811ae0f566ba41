"""The identified model of drive torque, and its file."""

from hybrid.model.dynamic_model import DynamicModel as DynamicModel
from hybrid.model.dynamic_model import check_same_arm as check_same_arm
