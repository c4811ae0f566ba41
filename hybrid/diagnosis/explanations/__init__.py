"""Explanations of a gap: sets of causes, their posterior, and the search for them."""
