"""From recordings to a dynamic model, and how well it predicts."""

from hybrid.identify.fit import Fit
from hybrid.identify.three_stage import identify
from hybrid.identify.validation import Validation, ValidationRow, predict, validate
from hybrid.model.dynamic_model import DynamicModel

__all__ = [
    "DynamicModel",
    "Fit",
    "Validation",
    "ValidationRow",
    "identify",
    "predict",
    "validate",
]
