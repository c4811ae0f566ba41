"""Batched rigid-body dynamics."""

from hybrid.dynamics.base import BaseParameters, base_parameters, inertial_labels
from hybrid.dynamics.body import RigidBody, simulated_torque
from hybrid.dynamics.law import Law
from hybrid.dynamics.regressor import (
    inverse_dynamics,
    regressor,
    regressor_gradient,
    regressor_law,
    torque_gradient,
)
from hybrid.dynamics.stacked import (
    effect_gains,
    rich_motion,
    stacked_base,
    stacked_columns,
)
from hybrid.dynamics.tape import Tape

__all__ = [
    "BaseParameters",
    "Law",
    "RigidBody",
    "Tape",
    "base_parameters",
    "effect_gains",
    "inertial_labels",
    "inverse_dynamics",
    "regressor",
    "regressor_gradient",
    "regressor_law",
    "rich_motion",
    "simulated_torque",
    "stacked_base",
    "stacked_columns",
    "torque_gradient",
]
