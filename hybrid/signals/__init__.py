"""Turn a recording into a motion: filter, differentiate and decimate.

Regressor columns are computed from a :class:`Motion` at its full rate. Columns and
measured torque then pass through the same :class:`Sampler`.
"""

from hybrid.signals.autocorrelation import autocorrelation_time
from hybrid.signals.cutoff import choose_cutoff
from hybrid.signals.filters import (
    Sampler,
    butterworth,
    butterworth_gain,
    central_difference,
    filter_reach,
)
from hybrid.signals.motion import Motion, motion_from_recording
from hybrid.signals.speed import speed_against_position

__all__ = [
    "Motion",
    "Sampler",
    "butterworth",
    "butterworth_gain",
    "central_difference",
    "choose_cutoff",
    "filter_reach",
    "autocorrelation_time",
    "motion_from_recording",
    "speed_against_position",
]
