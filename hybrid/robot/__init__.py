"""Serial arms from URDF and MJCF files."""

from hybrid.robot.chain import Chain
from hybrid.robot.robot import Robot

__all__ = ["Chain", "Robot"]
