"""Kinematic calibration: the geometry of an arm from measured poses."""

from hybrid.calibration.calibrate import Calibration as Calibration
from hybrid.calibration.calibrate import calibrate as calibrate
from hybrid.calibration.measurements import Measurements as Measurements
from hybrid.calibration.poses import choose_poses as choose_poses
from hybrid.calibration.poses import random_poses as random_poses
from hybrid.calibration.read import read_measurements as read_measurements
from hybrid.calibration.validate import Errors as Errors
from hybrid.calibration.validate import cross_validate as cross_validate
from hybrid.calibration.validate import nominal_errors as nominal_errors
