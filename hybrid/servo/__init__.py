"""Fit the position servos of an arm to logs of command and position, by replay."""

from hybrid.servo.drive import Drive
from hybrid.servo.fit import fit_servo
from hybrid.servo.servo_fit import ServoFit
from hybrid.servo.stretch import without_torque

__all__ = ["Drive", "ServoFit", "fit_servo", "without_torque"]
