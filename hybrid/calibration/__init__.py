"""Kinematic calibration: the geometry of an arm from measured poses."""

from hybrid.calibration.calibrate import (
    Calibration,
    build_setup,
    calibrate,
    observability_index,
)
from hybrid.calibration.measurements import Measurements
from hybrid.calibration.poses import choose_poses, random_poses
from hybrid.calibration.read import read_measurements
from hybrid.calibration.validate import Errors, cross_validate

__all__ = [
    "Calibration",
    "Errors",
    "Measurements",
    "build_setup",
    "calibrate",
    "choose_poses",
    "cross_validate",
    "observability_index",
    "random_poses",
    "read_measurements",
]
