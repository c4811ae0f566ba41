"""Where the sim-to-real gap lies, which effect causes it, and how far it shrinks."""
