"""Batched rigid-body dynamics."""

from hybrid.dynamics.base import BaseParameters as BaseParameters
from hybrid.dynamics.body import RigidBody as RigidBody
from hybrid.dynamics.body import simulated_torque as simulated_torque
from hybrid.dynamics.law import Law as Law
from hybrid.dynamics.regressor import inverse_dynamics as inverse_dynamics
from hybrid.dynamics.regressor import regressor as regressor
from hybrid.dynamics.regressor import regressor_gradient as regressor_gradient
from hybrid.dynamics.regressor import regressor_law as regressor_law
from hybrid.dynamics.regressor import torque_gradient as torque_gradient
from hybrid.dynamics.stacked import effect_gains as effect_gains
from hybrid.dynamics.stacked import rich_motion as rich_motion
from hybrid.dynamics.stacked import stacked_base as stacked_base
from hybrid.dynamics.stacked import stacked_columns as stacked_columns
from hybrid.dynamics.tape import Tape as Tape
