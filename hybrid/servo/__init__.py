"""Fit the position servos of an arm to logs of command and position, by replay."""

from hybrid.servo.fit import fit_servo as fit_servo
from hybrid.servo.servo_fit import ServoFit as ServoFit
from hybrid.servo.stretch import without_torque as without_torque
