"""What might explain a gap, and how much evidence there is for it."""
