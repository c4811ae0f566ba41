"""Find the tags of MJCF and URDF files, and change single numbers in them."""
