"""Machines are noisy: no property is timed, nor what its first example makes."""

from hypothesis import settings

settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")
