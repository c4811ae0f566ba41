"""Learners that experiments compare with the mixture of the package."""

from learners.network import NetworkRegression
from learners.random_features import RandomFeatureRegression
from learners.symmetric import SymmetricRegression

__all__ = ["NetworkRegression", "RandomFeatureRegression", "SymmetricRegression"]
