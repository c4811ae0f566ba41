"""The gap of some logs: measured, filtered, and where it counts."""
