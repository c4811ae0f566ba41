"""Serial arms from URDF and MJCF files."""

from hybrid.robot.robot import Robot as Robot
