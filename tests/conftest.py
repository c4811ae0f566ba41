"""Machines are noisy: no property is timed, nor what its first example makes."""

from hypothesis import settings

# "make fuzz" tries more.
settings.register_profile("untimed", deadline=None, max_examples=25)
settings.load_profile("untimed")
