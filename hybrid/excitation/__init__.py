"""Design of excitation motions for the identification of an arm."""

from hybrid.excitation.clearance import Clearance, Floor
from hybrid.excitation.constraints import Limits
from hybrid.excitation.criteria import (
    Condition,
    DOptimal,
)
from hybrid.excitation.design import Design, design
from hybrid.excitation.expected_error import ExpectedError
from hybrid.excitation.experiments import (
    at_speeds,
    micro_reversals,
    multisine,
    speed_ladder,
    static_poses,
)
from hybrid.excitation.families import (
    Fourier,
    Spline,
)
from hybrid.excitation.observation import Observation, observe
from hybrid.excitation.path import Trajectory

__all__ = [
    "Clearance",
    "Condition",
    "DOptimal",
    "Design",
    "ExpectedError",
    "Floor",
    "Fourier",
    "Limits",
    "Observation",
    "Spline",
    "Trajectory",
    "at_speeds",
    "design",
    "micro_reversals",
    "multisine",
    "observe",
    "speed_ladder",
    "static_poses",
]
