"""Explanations of a gap: sets of causes, and how probable they are."""
