"""Many arms over time."""
