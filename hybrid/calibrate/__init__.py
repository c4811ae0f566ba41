"""Kinematic calibration: the geometry of an arm from measured poses."""

from hybrid.calibrate.calibrate import Calibration, build_setup, calibrate
from hybrid.calibrate.measurements import Measurements
from hybrid.calibrate.observability import observability_index
from hybrid.calibrate.poses import choose_poses, random_poses
from hybrid.calibrate.read import read_measurements
from hybrid.calibrate.validate import Errors, cross_validate

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
