"""Recording -> motion: fuse, filter, differentiate, decimate.

Columns of a model are evaluated at full rate from a :class:`Motion`; columns and
measured torque then pass through the same :class:`Sampler`.
"""

from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import (
    Sampler,
    butterworth,
    butterworth_gain,
    central_difference,
    filter_reach,
)
from hybrid.signals.memory import memory
from hybrid.signals.motion import Motion, motion_from_recording
from hybrid.signals.speed import SpeedCheck, speed_against_position

__all__ = [
    "Motion",
    "Sampler",
    "SpeedCheck",
    "butterworth",
    "butterworth_gain",
    "central_difference",
    "choose_cutoff",
    "filter_reach",
    "memory",
    "motion_from_recording",
    "speed_against_position",
]
