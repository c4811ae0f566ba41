"""Robot files in which single numbers change: MJCF and URDF."""
