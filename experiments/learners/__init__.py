"""Learners that experiments compare with those of the package."""

from learners.random_features import RandomFeatureRegression
from learners.symmetric import SymmetricRegression

__all__ = ["RandomFeatureRegression", "SymmetricRegression"]
