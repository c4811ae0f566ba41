"""Identification of a dynamic model from recordings, and its validation."""

from hybrid.identification.fit import Fit as Fit
from hybrid.identification.three_stage import identify as identify
from hybrid.identification.validation import Validation as Validation
from hybrid.identification.validation import ValidationRow as ValidationRow
from hybrid.identification.validation import predict as predict
from hybrid.identification.validation import validate as validate
from hybrid.model.dynamic_model import DynamicModel as DynamicModel
