"""Identification of a dynamic model from recordings, and its validation."""

from hybrid.identification.fit import Fit
from hybrid.identification.three_stage import identify
from hybrid.identification.validation import (
    Validation,
    ValidationRow,
    predict,
    validate,
)
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
