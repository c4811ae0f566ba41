"""Turn a recording into a motion: filter, differentiate and decimate.

Regressor columns are computed from a :class:`Motion` at its full rate. Columns and
measured torque then pass through the same :class:`Sampler`.
"""

from hybrid.signals.autocorrelation import autocorrelation_time as autocorrelation_time
from hybrid.signals.cutoff import choose_cutoff as choose_cutoff
from hybrid.signals.filters import Sampler as Sampler
from hybrid.signals.filters import butterworth as butterworth
from hybrid.signals.filters import butterworth_gain as butterworth_gain
from hybrid.signals.filters import central_difference as central_difference
from hybrid.signals.motion import Motion as Motion
from hybrid.signals.motion import motion_from_recording as motion_from_recording
from hybrid.signals.speed import speed_against_position as speed_against_position
