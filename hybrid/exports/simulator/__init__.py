"""Write identified parameters to simulators: MJCF, URDF, Isaac Lab and MJX."""
