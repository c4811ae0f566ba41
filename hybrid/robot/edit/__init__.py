"""Change single numbers in MJCF and URDF files."""
