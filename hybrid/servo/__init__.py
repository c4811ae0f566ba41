"""Arms that log command and position only: the simulator's servo, fitted by replay."""

from hybrid.servo.drive import Drive
from hybrid.servo.fit import fit_servo
from hybrid.servo.servo_fit import ServoFit
from hybrid.servo.stretch import without_torque

__all__ = ["Drive", "ServoFit", "fit_servo", "without_torque"]
