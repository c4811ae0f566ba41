"""Recording -> motion: fuse, filter, differentiate, decimate, average periods.

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
from hybrid.signals.motion import Motion, motion_from_recording
from hybrid.signals.periodic import FourierMotion, average_periods, fourier_fit
from hybrid.signals.speed import SpeedCheck, speed_against_position

__all__ = [
    "FourierMotion",
    "Motion",
    "Sampler",
    "SpeedCheck",
    "average_periods",
    "butterworth",
    "butterworth_gain",
    "central_difference",
    "choose_cutoff",
    "filter_reach",
    "fourier_fit",
    "motion_from_recording",
    "speed_against_position",
]
