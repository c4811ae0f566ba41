"""Batched rigid-body dynamics."""

from hybrid.dynamics.base import BaseParameters, base_parameters, inertial_labels
from hybrid.dynamics.body import RigidBody
from hybrid.dynamics.regressor import inverse_dynamics, regressor

__all__ = [
    "BaseParameters",
    "RigidBody",
    "base_parameters",
    "inertial_labels",
    "inverse_dynamics",
    "regressor",
]
